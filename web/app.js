// Ties the page together: the address says what to show, the server says what there is, the panels draw it.

import { addressOf, readAddress, writeAddress } from "/assets/address.js";
import { getItems, getJson, keepToken, listen, query, save, token } from "/assets/api.js";
import { chartIn } from "/assets/chart.js";
import { showDevices } from "/assets/devices.js";
import { code, el, fill, problem, quiet } from "/assets/dom.js";
import { quality } from "/assets/format.js";
import { showPictures } from "/assets/pictures.js";
import { nameOf, showPoints } from "/assets/points.js";
import { budgetOnAxis, showRecommendation } from "/assets/recommend.js";
import { showOverview, showOverviewError, showSweeps } from "/assets/sweeps.js";

const at = (id) => document.getElementById(id);
const known = { sweeps: null, devices: [], sweep: null, tradeoff: null, failed: [], for: null };
let view = readAddress();

const tradeoffChart = chartIn(at("tradeoff"), { onPick: pick });
const stagesChart = chartIn(at("stages"));

function pick(datum, nearest) {
  if (!known.tradeoff) return;
  const named = known.tradeoff.points.find((point) => point.configuration_id === datum?.configuration_id);
  const near = nearest(known.tradeoff.points.map((point) => ({ ...placeOf(point), point })).filter(({ x, y }) => x && y));
  const chosen = named ?? near?.point;
  if (chosen) change({ point: chosen.configuration_id }, true);
}

// --- what is shown ------------------------------------------------------------------------------------------

function change(patch, step = false) {
  view = { ...view, ...patch };
  writeAddress(view, step);
  return show();
}

const chooseSweep = (id) => change({ sweep: id, scene: null, device: null, point: null, x: null, exposure: null }, true);
const choose = (patch) => change(patch, true);

// The view with its gaps filled from the data: energy where there is any, the sweep's own exposure, ...
function complete() {
  const { tradeoff } = known;
  const energy = tradeoff.energy_quality !== "time_only";
  const x = energy ? view.x ?? "energy_j" : "time_s";
  return {
    ...view, x, y: view.y ?? "difference", scale: view.scale ?? "auto",
    unit: energy ? view.unit ?? "j" : "s", exposure: view.exposure ?? tradeoff.exposure,
  };
}

const placeOf = (point) => {
  const { x, y } = complete();
  return { x: point[x]?.value, y: point[y]?.value };
};

async function show() {
  listSweeps();
  if (!known.sweeps) return;
  if (!view.sweep && known.sweeps.length) {
    view.sweep = known.sweeps[0].id;
    writeAddress(view, false);
    listSweeps();
  }
  if (!view.sweep) return showNothing();
  const wanted = JSON.stringify([view.sweep, view.scene, view.device]);
  if (known.for !== wanted) {
    if (known.sweep?.id !== view.sweep) fill(at("overview"), quiet("Loading the sweep …"));
    await loadSweep(wanted);
  }
  if (known.for === wanted) showSweep();
}

function listSweeps() {
  if (known.sweeps) showSweeps(at("sweeps"), known.sweeps, view.sweep, chooseSweep);
}

function showNothing() {
  at("sweep").hidden = true;
  fill(at("overview"), el("h2", {}, "Nothing to show yet"),
    quiet("A sweep renders scenes with many settings on your devices and finds out what each costs and how good it looks. "
      + "Submit one with ", code("joulebox sweep submit FILE.toml"), ", or run ", code("make demo"),
      " for a small one; it appears here as it runs."));
}

async function loadSweep(wanted) {
  const { sweep: id, scene, device } = view;
  try {
    const path = `/v1/sweeps/${encodeURIComponent(id)}`;
    const [sweep, tradeoff] = await Promise.all([getJson(path), getJson(`${path}/tradeoff${query({ scene, device })}`)]);
    const failed = sweep.jobs?.failed ? (await getItems(`${path}/jobs`)).filter((job) => job.state === "failed") : [];
    if (id !== view.sweep || scene !== view.scene || device !== view.device) return;
    Object.assign(known, { sweep, tradeoff, failed, for: wanted });
  } catch (error) {
    if (id !== view.sweep) return;
    known.for = null;
    at("sweep").hidden = true;
    showOverviewError(at("overview"), error, show);
  }
}

function showSweep() {
  const { sweep, tradeoff, failed } = known;
  const full = complete();
  const point = tradeoff.points.find((one) => one.configuration_id === view.point) ?? null;
  document.title = `${sweep.name} · joulebox`;
  showOverview(at("overview"), { sweep, tradeoff, failed }, choose);
  at("sweep").hidden = false;
  for (const badge of document.querySelectorAll("[data-quality]")) {
    const { label, explanation } = quality(tradeoff.energy_quality);
    badge.textContent = label;
    badge.title = explanation;
    badge.className = `quality ${tradeoff.energy_quality}`;
  }
  showControls(full, tradeoff);
  showCharts(full, tradeoff, point);
  showPoints(at("points"), tradeoff, view.point, (id) => change({ point: id }, true));
  showPictures(at("pictures"), tradeoff, point, full.exposure);
  showRecommendation(at("recommendation"), full, tradeoff, (id) => {
    change({ point: id }, true).then(() => at("pictures").scrollIntoView({ behavior: "smooth", block: "nearest" }));
  });
}

function showControls({ x, y, scale, exposure, budget, unit, images }, tradeoff) {
  const timeOnly = tradeoff.energy_quality === "time_only";
  const options = at("chart-options").elements;
  Object.assign(options.x, { value: x });
  options.x.querySelector("[value=energy_j]").disabled = timeOnly;
  options.y.value = y;
  options.scale.value = scale;
  const form = at("budget").elements;
  for (const option of form.unit.options) option.disabled = timeOnly && option.value !== "s";
  form.unit.value = unit;
  at("images-row").hidden = unit !== "wh";
  for (const [field, value] of [[form.budget, budget ?? ""], [form.images, images ?? "1000"], [at("exposure"), exposure]]) {
    if (field !== document.activeElement) field.value = value;
  }
}

// --- charts ---------------------------------------------------------------------------------------------------

const chartPath = (name, kind, parameters) =>
  `/v1/sweeps/${encodeURIComponent(known.sweep.id)}/charts/${name}.${kind}${query({ scene: known.tradeoff.scene, device: known.tradeoff.device, ...parameters })}`;

function showCharts(full, tradeoff, point) {
  if (!tradeoff.points.length) {
    const words = "No point yet: the first appears when a job of this scene and device is done. "
      + "Is an agent running (joulebox-agent run)?";
    tradeoffChart.say(quiet(words));
    stagesChart.say(quiet("The stages follow with the first point."));
    fill(at("downloads"));
    return;
  }
  const { x, y, scale } = full;
  const parameters = { x, y, scale, budget: budgetOnAxis(full, x) };
  tradeoffChart.mark(point && placeOf(point));
  draw(tradeoffChart, chartPath("tradeoff", "vl.json", parameters), `${y.replaceAll("_", " ")} against `
    + `${x === "time_s" ? "time" : quality(tradeoff.energy_quality).label} of ${tradeoff.points.length} settings; `
    + `${tradeoff.points.filter((one) => one.acceptable).length} stay within the limit of ${tradeoff.limit}. The table below has the numbers.`);
  draw(stagesChart, chartPath("stages", "vl.json", {}), `Cost of each rendering stage for ${tradeoff.points.map(nameOf).slice(0, 8).join("; ")}`);
  fill(at("downloads"), "Take it with you: ", ["svg", "png", "vl.json"].map((kind) => [
    el("button", {
      type: "button", class: "link", "data-key": `save-${kind}`,
      onclick: () => save(chartPath("tradeoff", kind, parameters), `${known.sweep.name}-tradeoff.${kind}`)
        .catch((error) => fill(at("downloads"), problem(error))),
    }, kind === "vl.json" ? "Vega-Lite" : kind.toUpperCase()), " "]));
}

const asked = new Map();
function draw(chart, path, description) {
  const turn = (asked.get(chart) ?? 0) + 1;
  asked.set(chart, turn);
  getJson(path).then(
    (spec) => { if (asked.get(chart) === turn) chart.show(spec, description); },
    (error) => { if (asked.get(chart) === turn) chart.say(problem(error, () => draw(chart, path, description))); },
  );
}

// --- fresh data -------------------------------------------------------------------------------------------------

async function refresh() {
  try {
    const [sweeps, devices] = await Promise.all([getItems("/v1/sweeps"), getItems("/v1/devices")]);
    Object.assign(known, { sweeps, devices, for: null });
    at("sign-in").hidden = true;
  } catch (error) {
    if (error.status === 401) return;
    if (!known.sweeps) {
      fill(at("sweeps"), problem(error, refresh));
      fill(at("devices"), quiet("They show when the server answers."));
      fill(at("overview"), quiet("Waiting for the server."));
    }
    throw error;
  }
  showDevices(at("devices"), known.devices);
  await show();
}

let due = null;
function refreshSoon() {
  due ??= setTimeout(() => { due = null; refresh().catch(() => {}); }, 600);
}

const CONNECTION = {
  live: ["live", "Changes appear by themselves"],
  polling: ["checking every 5 s", "The live stream is down; the page asks every five seconds instead"],
  lost: ["no answer", "The server does not answer; the page keeps trying. Is joulebox serve running?"],
};
function showConnection(state) {
  const [words, explanation] = CONNECTION[state];
  Object.assign(at("connection"), { textContent: words, title: explanation, className: `pill ${state}` });
}

// --- hands ----------------------------------------------------------------------------------------------------

at("chart-options").addEventListener("change", ({ target }) => change({ [target.name]: target.value }, true));
let typing = null;
function readBudget() {
  const form = at("budget").elements;
  clearTimeout(typing);
  typing = setTimeout(() => change({
    budget: Number(form.budget.value) > 0 ? form.budget.value : null,
    unit: form.unit.value, images: form.unit.value === "wh" ? form.images.value : null,
  }), 350);
}
at("budget").addEventListener("input", readBudget);
at("exposure").addEventListener("change", ({ target }) => change({ exposure: target.checkValidity() ? target.value || null : null }));
for (const id of ["chart-options", "budget", "exposure-form"]) {
  at(id).addEventListener("submit", (event) => event.preventDefault());
}
addEventListener("popstate", () => { view = readAddress(); show(); });

addEventListener("joulebox:sign-in", ({ detail }) => {
  at("sign-in").hidden = false;
  const words = at("sign-in").querySelector(".error");
  words.hidden = !detail;
  words.textContent = detail ? `That token did not open the door: ${detail}` : "";
  if (!known.sweeps) for (const id of ["sweeps", "devices", "overview"]) fill(at(id), quiet("Sign in to see this."));
});
at("sign-in").addEventListener("submit", async (event) => {
  event.preventDefault();
  keepToken(at("token").value.trim());
  await start();
});

async function start() {
  await refresh().catch(() => {});
  if (at("sign-in").hidden) listen({ onEvent: refreshSoon, onState: showConnection, onPoll: refresh });
}

if (location.hash && addressOf(view) === "#") history.replaceState(null, "", location.pathname);
if (token()) at("connection").title = "Signed in with the token of this tab";
start();
