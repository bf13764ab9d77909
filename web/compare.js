// The view that looks closely at two pictures: side by side, under a slider, blinking, or as a map of their difference.

import { getBytes, getJson, query } from "/assets/api.js";
import { choice, el, facts, fill, problem, quiet } from "/assets/dom.js";
import { number } from "/assets/format.js";
import { handle } from "/assets/lines.js";
import { panes, ZOOMS } from "/assets/panes.js";
import { differences } from "/assets/pictures.js";
import { coloured, luminanceDifference, readMap, readPfm, scaleStrip, SCALES, toned } from "/assets/pixels.js";

const MODES = { side: "Side by side", slider: "Slider", blink: "Blink", map: "Error map" };
const BLINK_MS = 700; // slower than three flashes a second, which could harm
const WAYS = "In a picture: arrow keys move the pixel cursor, + and − zoom, a drag moves the picture, a click picks a pixel.";
const box = document.getElementById("compare");
let context = null;
let pair = null; // what is looked at: the pictures as numbers, the comparison, and where they come from
let drawn = {};
let built = null;
let blinking = true;
let latest = 0;

const looking = panes({ sizeOf: () => pair && pair.test, onChange: ({ zoom, x, y }) => context.change({ zoom: zoom ? String(zoom) : null, at: x === null ? null : `${x},${y}` }) });
const wipe = handle({
  axis: "x", label: "Edge between reference and test", place: (part) => { const [left, right] = looking.edges(); return left + part * (right - left); },
  read: (pixel) => { const [left, right] = looking.edges(); return Math.min(Math.max((pixel - left) / (right - left), 0), 1); },
  told: (part) => `reference left of ${Math.round(100 * part)} %`,
  onMove: (part) => { context.view.split = part; looking.paint(); }, onDone: (part) => context.change({ split: part.toFixed(3) }),
});
const mode = () => (MODES[context.view.mode] ? context.view.mode : "side");
const kind = () => (SCALES[context.view.map] ? context.view.map : "jnd");
const exposure = () => Number(context.view.exposure ?? pair.exposure);

export async function showCompare(given) {
  context = given;
  const { view } = context;
  const wanted = JSON.stringify(["sweep", "scene", "device", "point", "against", "reference", "test"].map((key) => view[key]));
  if (pair?.for !== wanted) {
    const turn = ++latest;
    built = null;
    if (!pair) fill(box, quiet("Loading the pictures …"));
    try {
      const found = await load(view, wanted);
      if (turn !== latest) return;
      pair = found;
      drawn = {};
    } catch (error) {
      if (turn === latest) { pair = null; fill(box, problem(error, () => showCompare(context))); }
      return;
    }
  }
  document.title = "Compare · joulebox";
  show();
}

// --- what is compared --------------------------------------------------------------------------------------------

async function load(view, wanted) {
  const sweep = view.test ? { points: [], head: null } : await ofSweep(view);
  const { head, point } = sweep;
  const [reference, test] = [view.reference ?? sweep.reference, view.test ?? point?.image_sha256];
  const basis = { for: wanted, ...sweep, exposure: head?.exposure ?? 1 };
  if (!reference || !test) return { ...basis, test: null };
  const [one, other] = await Promise.all([reference, test].map(async (sha) => readPfm(await getBytes(`/v1/images/${sha}.pfm`))));
  if (one.width !== other.width || one.height !== other.height) {
    throw new Error(`The pictures are ${one.width} × ${one.height} and ${other.width} × ${other.height} pixels: only pictures of one size can be compared.`);
  }
  const compared = getJson(`/v1/compare${query({ reference, test, exposure: basis.exposure })}`);
  const map = compared.then(async (result) => readMap(await getBytes(`/v1/blobs/${result.delta_sha256}`)));
  const found = { ...basis, reference: one, test: other, result: null, map: null, fault: null };
  map.then(async (values) => Object.assign(found, { map: values, result: await compared }), (error) => { found.fault = error; })
    .finally(() => { if (pair === found) { drawn = {}; built = null; show(); } });
  return found;
}

async function ofSweep(view) {
  if (!view.sweep) return { points: [], head: null };
  const path = `/v1/sweeps/${encodeURIComponent(view.sweep)}`;
  const where = { scene: view.scene, device: view.device };
  const { usermeta: head, datasets } = await getJson(`${path}/charts/tradeoff.vl.json${query(where)}`);
  const points = datasets?.points ?? [];
  const id = points.some((row) => row.configuration_id === view.point) ? view.point : points[0]?.configuration_id;
  const get = (point) => getJson(`${path}/points/${encodeURIComponent(point)}${query(where)}`);
  const [point, against] = await Promise.all([id ? get(id) : null, view.against ? get(view.against) : null]);
  return { head, points, point, against, reference: against?.image_sha256 ?? point?.reference_image_sha256 };
}

// --- showing -------------------------------------------------------------------------------------------------------

function show() {
  const { view } = context;
  if (!pair.test) {
    fill(box, pair.points.length ? [chooser(), quiet("The reference or the picture of this point is not rendered yet; it comes with its job.")]
      : [quiet("No picture to compare yet. Choose a point in a sweep's chart, or wait for the first job of this sweep to be done."), el("p", {}, el("a", { href: context.linkTo({ view: "sweep" }) }, "To the sweep"))]);
    return;
  }
  const [x, y] = (view.at ?? "").split(",").map(Number);
  const size = pair.test;
  const inside = x >= 0 && y >= 0 && x < size.width && y < size.height;
  Object.assign(looking.place, { zoom: ZOOMS.includes(Number(view.zoom)) ? Number(view.zoom) : null, x: inside ? x : null, y: inside ? y : null });
  const layout = JSON.stringify([pair.for, mode(), kind(), Boolean(pair.map), pair.fault?.message]);
  if (built !== layout) build();
  built = layout;
  tone();
  controls();
  looking.paint();
  wipe.show(mode() === "slider" ? Number(view.split ?? 0.5) : null);
  readOut();
}

const names = () => {
  if (!pair.head) return { reference: "the other device's picture", test: "this device's picture" };
  return { reference: pair.against ? pair.against.label : `the reference of ${pair.head.scene}`, test: pair.point.label };
};

function build() {
  const { reference, test } = names();
  const stage = el("div", { class: `stage panes ${mode()}` });
  const figure = (name, words, caption, layers) => {
    const pane = looking.make(name, words, layers);
    stage.append(el("figure", {}, el("div", { class: "stage" }, pane, name === "slider" && wipe.node), el("figcaption", {}, caption)));
    return pane;
  };
  const map = () => figure("map", `Map of the difference between ${reference} and ${test}`, [`Error map: ${SCALES[kind()].words}`, legend()], () => [[drawn.map, 1]]);
  const shown = {
    side: () => [
      figure("reference", `Picture of ${reference}`, ["Reference: ", reference], () => [[drawn.reference, 1]]),
      figure("test", `Picture of ${test}`, ["Test: ", test], () => [[drawn.test, 1]]), map(),
    ],
    slider: () => [figure("slider", `${reference} on the left, ${test} on the right of a movable edge`, `Left of the edge: ${reference}. Right: ${test}.`,
      () => [[drawn.test, 1], [drawn.reference, partOfPane()]])],
    blink: () => [figure("blink", `${reference} and ${test} in turn`, el("span", { id: "blink-state" }), () => [[blinkShows() ? drawn.reference : drawn.test, 1]])],
    map: () => [map()],
  }[mode()]();
  looking.show(shown);
  fill(box, chooser(), el("form", { id: "compare-controls", class: "options", onsubmit: (event) => event.preventDefault() }), stage,
    el("output", { id: "pixel", class: "pixel" }), el("p", { class: "hint" }, WAYS),
    pair.fault ? problem(pair.fault) : pair.result ? facts(differences(pair.head, pair.point, pair.result)) : quiet("Comparing the pictures …"));
}

function partOfPane() {
  const [left, right] = looking.edges();
  const pane = box.querySelector("[data-pane=slider]");
  return (left + Number(context.view.split ?? 0.5) * (right - left)) / pane.clientWidth;
}

// The pictures as they are looked at, made anew only when the exposure or the map changed.
function tone() {
  const key = `${exposure()} ${kind()}`;
  if (drawn.key === key) return;
  const values = kind() === "jnd" ? pair.map : luminanceDifference(pair.reference, pair.test, exposure());
  drawn = { key, values, reference: toned(pair.reference, exposure()), test: toned(pair.test, exposure()), map: values && coloured(values, kind()) };
}

function legend() {
  const { low, high, unit, ticks } = SCALES[kind()];
  const strip = el("canvas", { width: "256", height: "1", "aria-hidden": "true" });
  scaleStrip(strip, kind());
  const marks = ticks.map((tick) => {
    const mark = el("span", {}, number(tick));
    mark.style.left = `${(100 * (tick - low)) / (high - low)}%`;
    return mark;
  });
  return el("span", { class: "legend", role: "img", "aria-label": `Scale from ${low} to ${high} ${unit}` }, strip, el("span", { class: "ticks" }, marks), el("span", {}, ` ${unit}`));
}

function chooser() {
  const { view, change } = context;
  if (!pair.head || view.test) return el("p", {}, "Two pictures of the same settings from two devices, which should agree. ", el("a", { href: context.linkTo({ view: "fleet", reference: null, test: null }) }, "Back to the fleet"));
  const { head, points } = pair;
  const labels = points.map((row) => [row.configuration_id, row.label]);
  const set = (name, more = {}) => (value) => change({ [name]: value || null, ...more }, true);
  return el("form", { class: "options", "aria-label": "What to compare", onsubmit: (event) => event.preventDefault() },
    choice("Scene", "compare-scene", head.scenes.map((name) => [name, name]), head.scene, set("scene", { point: null, against: null })),
    choice("Device", "compare-device", head.devices.map((name) => [name, name]), head.device, set("device", { point: null, against: null })),
    choice("Reference", "compare-against", [["", "the reference"], ...labels], view.against ?? "", set("against")),
    choice("Test", "compare-point", labels, pair.point?.configuration_id, set("point")));
}

function controls() {
  const { view, change } = context;
  const number_field = el("input", { type: "number", name: "exposure", min: "0.001", max: "1000", step: "any", value: exposure(), "data-key": "exposure",
    onchange: ({ target }) => change({ exposure: Number(target.value) > 0 ? target.value : null }) });
  const stops = el("input", { type: "range", min: "-8", max: "8", step: "0.25", value: Math.log2(exposure() / pair.exposure), "aria-label": "Exposure in stops", "data-key": "stops",
    "aria-valuetext": `${number(Math.log2(exposure() / pair.exposure))} stops from the sweep's own`,
    oninput: ({ target }) => change({ exposure: String(Number((pair.exposure * 2 ** target.value).toPrecision(4))) }) });
  const form = document.getElementById("compare-controls");
  if (form.contains(document.activeElement) && document.activeElement.type === "range") { // keeps a slider in the hand that moves it
    form.elements.exposure.value = exposure();
    return;
  }
  fill(form,
    el("fieldset", { class: "segments" }, el("legend", { class: "unseen" }, "How to compare"), Object.entries(MODES).map(([value, words]) => el("label", {},
      el("input", { type: "radio", name: "mode", value, checked: mode() === value, "data-key": `mode-${value}`, onchange: () => change({ mode: value }, true) }), el("span", {}, words)))),
    choice("Zoom", "zoom", [["", "fit"], ...ZOOMS.map((zoom) => [zoom, `${zoom}:1`])], view.zoom ?? "", (value) => change({ zoom: value || null })),
    choice("Map", "map", [["jnd", "visible difference [JND]"], ["luminance", "luminance, signed"]], kind(), (value) => change({ map: value })),
    el("label", {}, "Exposure ", number_field), stops,
    mode() === "blink" && el("button", { type: "button", class: "quiet-button", "data-key": "pause-blink", onclick: () => { blinking = !blinking; controls(); } }, blinking ? "Stop blinking" : "Blink"));
}

function readOut() {
  const { x, y } = looking.place;
  const output = document.getElementById("pixel");
  if (x === null) { output.textContent = "Pick a pixel to read its values."; return; }
  const rgb = ({ data, width }) => [0, 1, 2].map((c) => number(data[3 * (y * width + x) + c])).join(" ");
  const value = drawn.values?.data[y * pair.test.width + x];
  output.textContent = `x ${x}, y ${y} · reference ${rgb(pair.reference)} · test ${rgb(pair.test)} (linear red, green, blue)`
    + (value === undefined ? "" : ` · difference ${number(value)}${kind() === "jnd" && value >= SCALES.jnd.high ? " or more" : ""} ${SCALES[kind()].unit}`);
}

// --- time and size ---------------------------------------------------------------------------------------------------

const blinkShows = () => Math.floor(performance.now() / BLINK_MS) % 2 === 0;
setInterval(() => {
  if (context?.view.view !== "compare" || !pair?.test || mode() !== "blink" || !blinking) return;
  looking.paint();
  document.getElementById("blink-state").textContent = blinkShows() ? `Now: ${names().reference}` : `Now: ${names().test}`;
}, BLINK_MS / 2);
new ResizeObserver(() => { if (context?.view.view === "compare" && pair?.test && built) { looking.paint(); wipe.show(mode() === "slider" ? Number(context.view.split ?? 0.5) : null); } }).observe(box);
