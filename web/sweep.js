// The view of one sweep: its head, the trade-off chart with its lines and selection, stages, trace and table.

import { readOnly, writeOnly } from "/assets/address.js";
import { getItems, getJson, getText, query, save } from "/assets/api.js";
import { chartIn } from "/assets/chart.js";
import { button, code, el, fill, link, problem, quiet } from "/assets/dom.js";
import { number, quality } from "/assets/format.js";
import { handle } from "/assets/lines.js";
import { showPictures } from "/assets/pictures.js";
import { showPoints, told } from "/assets/points.js";
import { budgetOnAxis, showRecommendation } from "/assets/recommend.js";
import { showOverview } from "/assets/sweeps.js";

const at = (id) => document.getElementById(id);
const loaded = { for: null, sweep: null, head: null, rows: [], text: "", failed: [], progress: null, point: null };
let context = null;
let stale = true;
let drawnFor = {}; // the limit and budget that the chart's axes were made for
const UNITS = { energy_j: "J", time_s: "s", energy_j_per_pixel: "J a pixel" };

const limitLine = handle({
  axis: "y", label: "Limit line", place: (value) => chart.pixel("y", value), read: (pixel) => chart.value("y", pixel),
  told: (value) => `acceptable below ${number(value)}`,
  onMove: (value) => chart.set("limit", value), onDone: (value) => context.change({ limit: trimmed(value / perPixel("y")) }),
});
const budgetLine = handle({
  axis: "x", label: "Budget line", place: (value) => chart.pixel("x", value), read: (pixel) => chart.value("x", pixel),
  told: (value) => `budget ${number(value)} ${UNITS[axis()]}`,
  onMove: (value) => chart.set("budget", value), onDone: (value) => setBudget(value),
});
const chart = chartIn(at("tradeoff"), { onPick: pick, onDrawn: placeLines, lines: [limitLine.node, budgetLine.node] });
const stagesChart = chartIn(at("stages"));
const traceChart = chartIn(at("trace"));

const trimmed = (value) => String(Number(value.toPrecision(4)));
const pixels = () => loaded.head.width * loaded.head.height;
const perPixel = (name) => (context.view[name]?.endsWith("_per_pixel") ? 1 / pixels() : 1);
const axis = () => context.view.x ?? (loaded.head?.energy_quality === "time_only" ? "time_s" : "energy_j");
const limit = () => Number(context.view.limit ?? loaded.head.limit) * perPixel("y");
const budget = () => budgetOnAxis(context, loaded, axis());

// A budget from the chart's axis: in the unit of the panel where that is one of an image, else in joules or seconds.
function setBudget(value) {
  if (axis() === "time_s") return context.change({ budget: trimmed(value), unit: "s" });
  const factor = axis() === "energy_j_per_pixel" ? pixels() : 1;
  return context.change({ budget: trimmed(value * factor), unit: "j" });
}

function pick(datum, nearest) {
  const chosen = datum?.configuration_id ?? nearest(loaded.rows)?.configuration_id;
  if (chosen && loaded.rows.some((row) => row.configuration_id === chosen)) context.change({ point: chosen }, true);
}

// --- loading ---------------------------------------------------------------------------------------------------

export const staleSweep = () => { stale = true; };

export async function showSweepView(given) {
  context = given;
  const { view } = context;
  if (!view.sweep) return showNothing();
  const wanted = JSON.stringify(["sweep", "scene", "device", "x", "y", "scale", "colour", "only", "predicted"].map((key) => view[key]));
  at("sweep").inert = loaded.sweep?.id !== view.sweep; // what is still in sight belongs to another sweep
  if (at("sweep").inert) fill(at("overview"), quiet("Loading the sweep …"));
  if (stale || loaded.for !== wanted || !fits()) {
    if (stale || underWay.wanted !== wanted || loaded.for === wanted) begin(wanted);
    const { done, signal } = underWay;
    try {
      await done;
    } catch (error) {
      if (signal.aborted) return undefined;
      loaded.for = null;
      underWay = {};
      if (error.code === "not_answerable" && view.x) return context.change({ x: null, only: null, colour: null });
      at("sweep").hidden = true;
      fill(at("overview"), problem(error, () => showSweepView(context)));
      return undefined;
    }
  }
  return loaded.for === wanted ? showSweep() : undefined;
}

// Whether limit and budget lie on the axes as drawn: else the chart is asked for anew, with room for them.
function fits() {
  if (!chart.drawn() || !loaded.rows.length) return true;
  const cost = budget();
  return (chart.pixel("y", limit()) !== null || drawnFor.limit === context.view.limit)
    && (cost === null || chart.pixel("x", cost) !== null || drawnFor.budget === cost);
}

const chartPath = (name, kind, parameters) => {
  const { sweep, scene, device } = context.view;
  return `/v1/sweeps/${encodeURIComponent(sweep)}/charts/${name}.${kind}${query({ scene, device, ...parameters })}`;
};

function tradeoffPath(kind, lines) {
  const { x, y, scale, colour, only, predicted } = context.view;
  const path = chartPath("tradeoff", kind, { x, y, scale, colour_by: colour, predicted, ...lines });
  return readOnly(only).reduce((so, chosen) => `${so}${so.includes("?") ? "&" : "?"}only=${encodeURIComponent(chosen)}`, path);
}

let underWay = {}; // the load that a newer one makes pointless
function begin(wanted) {
  underWay.controller?.abort();
  const controller = new AbortController();
  stale = false;
  underWay = { wanted, controller, signal: controller.signal, done: load(wanted, controller.signal) };
}

async function load(wanted, signal) {
  const { view } = context;
  const path = `/v1/sweeps/${encodeURIComponent(view.sweep)}`;
  const lines = loaded.head && loaded.sweep.id === view.sweep ? { limit: view.limit, budget: budget() } : { limit: view.limit };
  const [sweep, text] = await Promise.all([getJson(path, { signal }), getText(tradeoffPath("vl.json", lines), { signal })]);
  const running = ["running", "paused"].includes(sweep.state);
  const [failed, progress] = await Promise.all([
    sweep.jobs.failed ? getItems(`${path}/jobs`).then((jobs) => jobs.filter((job) => job.state === "failed")) : [],
    running ? getJson(`${path}/progress`).catch(() => null) : null,
  ]);
  if (signal.aborted) return; // somebody went on meanwhile; a newer load shows where to
  const { usermeta: head, datasets } = text === loaded.text ? { usermeta: loaded.head, datasets: { points: loaded.rows } } : JSON.parse(text);
  drawnFor = lines;
  Object.assign(loaded, { for: wanted, sweep, head, text, failed, progress, rows: datasets?.points ?? [], predicted: datasets?.predictions ?? [] });
}

function showNothing() {
  at("sweep").hidden = true;
  fill(at("overview"), el("h2", {}, "Nothing to show yet"),
    quiet("A sweep renders scenes with many settings on your devices and finds out what each costs and how good it looks. "
      + "Paste one into “New sweep”, submit one with ", code("joulebox sweep submit FILE.toml"), ", or run ", code("make demo"),
      " for a small one; it appears here as it runs."));
}

// --- showing ---------------------------------------------------------------------------------------------------

function showSweep() {
  const { sweep, head, rows } = loaded;
  const { view, change } = context;
  document.title = `${sweep.name} · joulebox`;
  showOverview(at("overview"), loaded, context);
  Object.assign(at("sweep"), { hidden: false, inert: false });
  for (const badge of document.querySelectorAll("[data-quality]")) {
    const { label, explanation } = quality(head.energy_quality);
    Object.assign(badge, { textContent: label, title: explanation, className: `quality ${head.energy_quality}` });
  }
  const row = rows.find((one) => one.configuration_id === view.point) ?? null;
  showControls();
  showCharts(row);
  showPoints(at("points"), at("points-details"), { rows, head, limit: limit(), chosen: view.point }, (id) => change({ point: id }, true));
  showPoint(row);
  showRecommendation(at("recommendation"), context, loaded, (id) => {
    change({ point: id }, true).then(() => at("pictures").scrollIntoView({ behavior: "smooth", block: "nearest" }));
  });
}

function showControls() {
  const { view, change } = context;
  const { head } = loaded;
  const form = at("chart-options").elements;
  for (const option of form.x.options) option.disabled = head.energy_quality === "time_only" && option.value !== "time_s";
  const names = ["", ...Object.keys(head.settings)];
  fill(form.colour, names.map((name) => el("option", { value: name }, name || "automatic")));
  const shown = { x: axis(), y: view.y ?? "difference", scale: view.scale ?? "auto", colour: view.colour ?? "", limit: trimmed(Number(view.limit ?? head.limit)) };
  for (const [name, value] of Object.entries(shown)) if (form[name] !== document.activeElement) form[name].value = value;
  form.predicted.checked = Boolean(view.predicted);
  const chosen = readOnly(view.only);
  const toggle = (name) => change({ only: writeOnly(chosen.includes(name) ? chosen.filter((one) => one !== name) : [...chosen, name]) });
  const many = Object.entries(head.settings).filter(([, values]) => values.length > 1 && values.length <= 12);
  at("selection").hidden = !many.length;
  at("selection-state").textContent = chosen.length ? `: ${loaded.rows.filter((row) => row.shown).length} of ${loaded.rows.length} points` : "";
  fill(at("selection-groups"), many.map(([name, values]) => el("fieldset", {}, el("legend", {}, name),
    values.map((value) => el("label", {}, el("input", {
      type: "checkbox", "data-key": `only-${name}:${value}`, checked: chosen.includes(`${name}:${value}`), onchange: () => toggle(`${name}:${value}`),
    }), ` ${value}`)))), chosen.length > 0 && button("Show all", "only-all", () => change({ only: null }), { class: "quiet-button" }));
}

function showCharts(row) {
  const { sweep, head, rows, text } = loaded;
  if (!rows.length) {
    const words = head.point_count
      ? "The pictures are not compared yet: points appear when the reference is rendered and compared."
      : "No point yet: the first appears when a job of this scene and device is done. Is an agent running (joulebox-agent run)?";
    chart.say(quiet(words));
    stagesChart.say(quiet("The stages follow with the first point."));
    fill(at("downloads"));
    return;
  }
  chart.mark(row);
  const cost = axis() === "time_s" ? "time" : quality(head.energy_quality).label;
  chart.show(text, `Difference against ${cost} of ${told(rows, limit())}`).then(() => { if (!fits()) showSweepView(context); });
  draw(stagesChart, chartPath("stages", "vl.json", { point: context.view.point }), `Cost of each rendering stage, a bar for each of ${Math.min(rows.length, 24)} settings or fewer, cheapest first, and the reference`);
  const kinds = { svg: "SVG", png: "PNG", "vl.json": "Vega-Lite" };
  fill(at("downloads"), "Take the chart with you: ", Object.entries(kinds).map(([kind, words]) => [button(words, `save-${kind}`,
    () => save(tradeoffPath(kind, { limit: context.view.limit, budget: budget() }), `${sweep.name}-tradeoff.${kind}`).catch((error) => fill(at("downloads"), problem(error))),
    { class: "link" }), " "]));
}

function placeLines() {
  if (!loaded.head || !loaded.rows.length) return;
  chart.set("limit", limit());
  chart.set("budget", budget());
  limitLine.show(limit());
  budgetLine.show(budget());
}

const asked = new Map();
function draw(target, path, description) {
  const turn = (asked.get(target) ?? 0) + 1;
  asked.set(target, turn);
  return getText(path).then(
    (text) => { if (asked.get(target) === turn) target.show(text, description); },
    (error) => { if (asked.get(target) === turn) target.say(error.code === "not_answerable" ? quiet(error.message) : problem(error, () => draw(target, path, description))); },
  );
}

// The chosen point: its pictures, and the discharge trace of its measurement.
async function showPoint(row) {
  const { view, linkTo } = context;
  const box = at("pictures");
  if (!row) {
    loaded.point = null;
    showPictures(box, null);
    fill(box, quiet(loaded.rows.length ? "Choose a point of the chart or a row of its table to see its picture beside the reference."
      : "No picture yet: the first appears when the first job is done."));
    traceChart.say(quiet("Choose a point: here stands how its power went while it was measured."));
    return;
  }
  draw(traceChart, chartPath("trace", "vl.json", { point: view.point }), `Power against time while ${row.label} was measured`);
  const { scene, device } = view;
  try {
    const path = `/v1/sweeps/${encodeURIComponent(view.sweep)}/points/${encodeURIComponent(view.point)}${query({ scene, device })}`;
    const point = await getJson(path);
    if (context.view.point === view.point) showPictures(box, point, loaded.head, link("Compare closely: slider, blink, zoom, error map", linkTo({ view: "compare", reference: null, test: null }), "to-compare-point"));
  } catch (error) {
    if (context.view.point === view.point) fill(box, problem(error, () => showPoint(row)));
  }
}

// --- hands -----------------------------------------------------------------------------------------------------

at("chart-options").addEventListener("submit", (event) => event.preventDefault());
at("chart-options").addEventListener("change", ({ target }) => {
  if (target.name === "limit") return context.change({ limit: Number(target.value) > 0 ? target.value : null });
  const value = target.type === "checkbox" ? (target.checked ? "true" : null) : target.value;
  return context.change({ [target.name]: value }, true);
});
