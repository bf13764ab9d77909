// The answer to "what does my budget buy?": a slider, the settings with their intervals and reasons, ready to be taken along.

import { getJson, query, send } from "/assets/api.js";
import { button, code, copyButton, el, facts, fill, problem, quiet } from "/assets/dom.js";
import { interval, number, percent, quality, settingsText } from "/assets/format.js";

const at = (id) => document.getElementById(id);
const IMAGES = 1000;
const STEPS = 1000; // of the slider, evenly in the logarithm
let latest = 0;
let shown = null; // what the box says now, so that a live update does not have it read out again
let answered = null; // the question that it answers
let context = null;
let span = null;

const batteryOf = ({ known }, head) => known.fleet.get(head.device)?.battery?.full_j ?? null;

// What the server is asked for, from what was typed; null when nothing was.
function budgetQuery({ budget, unit, images }, timeOnly) {
  if (!budget) return null;
  const count = images || IMAGES;
  const asked = { j: { budget_j: budget }, wh: { budget_wh: budget, images: count }, percent: { battery_percent: budget, images: count }, s: { budget_s: budget } };
  return asked[unit] ?? (timeOnly ? asked.s : asked.j);
}

// Joules of one image that a budget comes to, null where that is not known.
function joules({ budget, unit, images }, full_j) {
  const amount = Number(budget);
  if (unit === "wh") return (amount * 3600) / Number(images || IMAGES);
  if (unit === "percent") return full_j && ((amount / 100) * full_j) / Number(images || IMAGES);
  return amount;
}

// The budget for one image in the unit of the chart's axis, for its budget line; null when it does not fit the axis.
export function budgetOnAxis(given, { head }, axis) {
  const { view } = given;
  if (!view.budget || !head) return null;
  const unit = view.unit ?? (head.energy_quality === "time_only" ? "s" : "j");
  if (axis === "time_s") return unit === "s" ? Number(view.budget) : null;
  const per_image = unit === "s" ? null : joules({ ...view, unit }, batteryOf(given, head));
  return per_image && (axis === "energy_j_per_pixel" ? per_image / (head.width * head.height) : per_image);
}

// Lowest and highest budget that the slider offers, in the chosen unit: from the cheapest point to the reference.
function spanOf(unit, images, { head, rows }, full_j) {
  const axis = unit === "s" ? "time_s" : "energy_j";
  const costs = [...rows.map((row) => row[`${axis}_value`]), head.reference?.[axis]?.value].filter((cost) => cost > 0);
  if (!costs.length) return null;
  const scale = { wh: images / 3600, percent: full_j ? (100 * images) / full_j : null }[unit] ?? 1;
  if (unit === "percent" && !full_j) return null;
  const high = 1.2 * Math.max(...costs) * scale;
  return [0.7 * Math.min(...costs) * scale, unit === "percent" ? Math.min(high, 100) : high];
}

function showForm(loaded) {
  const { view } = context;
  const { head } = loaded;
  const form = at("budget").elements;
  const timeOnly = head.energy_quality === "time_only";
  const full_j = batteryOf(context, head);
  const unit = timeOnly ? "s" : view.unit ?? "j";
  for (const option of form.unit.options) {
    option.disabled = (timeOnly && option.value !== "s") || (option.value === "percent" && !full_j);
    if (option.value === "percent") option.textContent = full_j ? "% of the battery for all" : "% of the battery (capacity not known)";
  }
  form.unit.value = unit;
  const images = view.images ?? String(IMAGES);
  at("images-row").hidden = !["wh", "percent"].includes(unit);
  for (const [field, value] of [[form.budget, view.budget ?? ""], [form.images, images]]) if (field !== document.activeElement) field.value = value;
  form.untried.checked = Boolean(view.untried);
  span = spanOf(unit, Number(images), loaded, full_j);
  form.slider.disabled = !span;
  if (!span || form.slider === document.activeElement) return;
  const part = view.budget ? Math.log(view.budget / span[0]) / Math.log(span[1] / span[0]) : 1;
  form.slider.value = Math.round(STEPS * Math.min(Math.max(part, 0), 1));
  form.slider.setAttribute("aria-valuetext", view.budget ? `${number(Number(view.budget))} ${form.unit.selectedOptions[0].textContent}` : "no budget yet");
}

export async function showRecommendation(box, given, loaded, choose) {
  context = given;
  showForm(loaded);
  const turn = ++latest;
  const { view } = context;
  const { head, rows } = loaded;
  const timeOnly = head.energy_quality === "time_only";
  const asked = budgetQuery({ ...view, unit: timeOnly ? "s" : view.unit }, timeOnly);
  if (!asked || !rows.length) {
    shown = answered = null;
    box.setAttribute("aria-busy", "false");
    fill(box, quiet(rows.length ? `Say what a picture may cost${timeOnly ? " in seconds" : ""}, and joulebox names the settings that give `
      + "the best picture for it." : "It answers as soon as there are points to choose from."));
    return;
  }
  const question = query({ scene: head.scene, device: head.device, ...asked, difference_limit: view.limit, predict: view.untried });
  const path = `/v1/sweeps/${encodeURIComponent(head.sweep_id)}/recommendation`;
  if (shown === null) fill(box, quiet("Looking for the settings that it buys …"));
  box.setAttribute("aria-busy", String(path + question !== answered)); // an old answer stays in sight, but takes no clicks
  try {
    const answer = await getJson(path + question);
    const text = JSON.stringify([answer, rows.length]);
    if (turn !== latest) return;
    answered = path + question;
    box.setAttribute("aria-busy", "false");
    if (text === shown) return;
    shown = text;
    const tools = { rows, choose, head, confirm: confirmation(path, question, answer) };
    fill(box, answer.answer === "settings" ? found(answer, tools) : none(answer, tools));
  } catch (error) {
    if (turn !== latest) return;
    shown = answered = null;
    box.setAttribute("aria-busy", "false");
    fill(box, problem(error));
  }
}

// A predicted choice was never measured and has no picture.
function lookAt(choice, { rows, choose }, words) {
  const known = rows.some((row) => row.configuration_id === choice.configuration_id);
  return known && button(words, `look-${words}`, () => choose(choice.configuration_id), { class: "link" });
}

const nameOf = (choice) => choice.label || settingsText(choice.changed);
const costs = ({ energy_j, time_s }, kind) =>
  [energy_j && interval(energy_j, quality(kind).unit), time_s && interval(time_s, "s")].filter(Boolean).join(", ");

function savings(answer, kind) {
  if (!Number.isFinite(answer.saves_share)) return null;
  const inSeconds = answer.budget_s !== null || !Number.isFinite(answer.saves_j);
  const amount = inSeconds ? [answer.saves_s, "s"] : [answer.saves_j, quality(kind).unit];
  const [word, sign] = answer.saves_share < 0 ? ["Costs more", -1] : ["Saves", 1];
  return [word, `${number(sign * amount[0])} ${amount[1]} an image: ${percent(sign * answer.saves_share)} of the reference`];
}

function found(answer, tools) {
  const kind = answer.energy_quality;
  const next = answer.runner_up;
  return [
    el("p", { class: "answer" }, nameOf(answer)),
    answer.basis === "predicted" && el("p", { class: "notice" }, "Predicted from its neighbours, never measured itself."),
    answer.fragile && el("p", { class: "notice" }, el("strong", {}, "Fragile. "), answer.fragile),
    facts([
      answer.energy_j && ["Energy an image", interval(answer.energy_j, quality(kind).unit)],
      answer.time_s && ["Time an image", interval(answer.time_s, "s")],
      ["Difference", `${interval(answer.difference)} of ${number(answer.limit)} acceptable`],
      savings(answer, kind),
    ].filter(Boolean)),
    lookAt(answer, tools, "See its picture"),
    answer.why.length > 0 && [el("h3", {}, "Why"), el("ul", {}, answer.why.map((reason) => el("li", {}, reason)))],
    takeAlong(answer),
    next && [el("h3", {}, "Runner-up"), option(next, kind, tools, "See the runner-up's picture")],
    tools.confirm,
  ];
}

// The settings as a file for `--settings`, and as one line for a shell. A scene's label holds its defines.
function takeAlong({ scene, settings }) {
  const [name, ...defines] = scene.split(" ");
  const file = JSON.stringify(settings, null, 2);
  const words = Object.entries(settings).map(([key, value]) => `--set ${key}=${value}`).join(" ");
  const line = `joulebox-render render ${[name, ...defines.map((define) => `-D ${define}`)].join(" ")} ${words} -o ${name}.exr`;
  const [shownFile, shownLine] = [el("pre", { tabindex: "0", "aria-label": "Settings file" }, file), el("pre", { tabindex: "0", "aria-label": "Command line" }, line)];
  return el("details", {}, el("summary", { "data-key": "take-along" }, "Take the settings along"),
    el("p", {}, "As a file for ", code("joulebox-render render SCENE --settings FILE.json"), ": ", copyButton("Copy the settings file", "copy-file", file, shownFile)), shownFile,
    el("p", {}, "As a command line: ", copyButton("Copy the command line", "copy-line", line, shownLine)), shownLine);
}

// Queues what promises more but was not measured, or not closely enough, so that the answer can rest on it.
const queued = { for: null, said: el("div", { role: "status" }) }; // outlives the live updates that follow
function confirmation(path, question, { proposals }) {
  if (queued.for !== question) { queued.for = question; fill(queued.said); }
  const { said } = queued;
  if (!proposals.length) return said;
  const queue = async () => {
    try {
      const { queued_jobs: jobs } = await send("POST", `${path}:confirm${question}`, { count: proposals.length });
      fill(said, quiet(`${jobs} ${jobs === 1 ? "job is" : "jobs are"} queued; the answer changes as they arrive.`));
    } catch (error) { fill(said, problem(error)); }
  };
  return [el("h3", {}, "What might be better still"),
    el("ul", {}, proposals.slice(0, 3).map((choice) => el("li", {}, `${nameOf(choice)}: difference ${interval(choice.difference)}, ${choice.basis === "predicted" ? "predicted" : "measured too loosely"}`))),
    button(`Measure ${proposals.length === 1 ? "it" : `these ${proposals.length}`} to know`, "confirm", queue, { class: "quiet-button" }), said];
}

function option(choice, kind, tools, words) {
  return el("p", {}, el("strong", {}, nameOf(choice)), `: ${costs(choice, kind)}, difference ${interval(choice.difference)}. `,
    choice.misses && el("span", { class: "detail" }, `Misses: ${choice.misses.replace(/\.?$/, ".")} `),
    lookAt(choice, tools, words));
}

function none(answer, tools) {
  const { energy_quality: kind, nearest } = answer;
  return [
    el("p", { class: "answer none" }, "No setting meets this budget and the limit."),
    answer.why.length > 0 && el("ul", {}, answer.why.map((reason) => el("li", {}, reason))),
    nearest.length > 0 && [el("h3", {}, nearest.length > 1 ? "The nearest two" : "The nearest"),
      nearest.map((choice, index) => option(choice, kind, tools, `See picture ${index + 1}`))],
    quiet("Raise the budget or the limit, or submit a sweep that reaches further down."),
    tools.confirm,
  ];
}

// --- hands -----------------------------------------------------------------------------------------------------

let typing = null;
at("budget").addEventListener("submit", (event) => event.preventDefault());
at("budget").addEventListener("input", ({ target }) => {
  const form = at("budget").elements;
  if (target === form.slider && span) form.budget.value = Number((span[0] * (span[1] / span[0]) ** (form.slider.value / STEPS)).toPrecision(3));
  const unitChanged = target === form.unit; // the same number would mean something else
  if (unitChanged) form.budget.value = "";
  clearTimeout(typing);
  typing = setTimeout(() => context?.change({
    budget: Number(form.budget.value) > 0 ? form.budget.value : null, unit: form.unit.value,
    images: ["wh", "percent"].includes(form.unit.value) ? form.images.value : null, untried: form.untried.checked ? "true" : null,
  }), unitChanged ? 0 : 250);
});
