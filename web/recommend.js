// The answer to "what does my budget buy?", in words, with its intervals and its reasons.

import { getJson, query } from "/assets/api.js";
import { code, el, facts, fill, problem, quiet } from "/assets/dom.js";
import { interval, number, percent, quality, settingsText } from "/assets/format.js";

// What the server is asked for, from what was typed; null when nothing was.
export function budgetQuery({ budget, unit, images }) {
  if (!budget) return null;
  if (unit === "s") return { budget_s: budget };
  return unit === "wh" ? { budget_wh: budget, images: images || 1000 } : { budget_j: budget };
}

// The budget for one image in the unit of the chart's axis, for its budget line; null when it does not fit the axis.
export function budgetOnAxis({ budget, unit, images }, axis) {
  if (!budget) return null;
  if (axis === "time_s") return unit === "s" ? Number(budget) : null;
  if (unit === "s") return null;
  return unit === "wh" ? (Number(budget) * 3600) / Number(images || 1000) : Number(budget);
}

let latest = 0;
let shown = null; // what the box says now, so that a live update does not have it read out again

export async function showRecommendation(box, view, tradeoff, choose) {
  const turn = ++latest;
  const asked = budgetQuery(view);
  const timeOnly = tradeoff.energy_quality === "time_only";
  if (!asked) {
    shown = null;
    fill(box, quiet(`Type what a picture may cost${timeOnly ? " in seconds" : ""}, and joulebox names the settings that give `
      + "the best picture for it."));
    return;
  }
  try {
    const answer = await getJson(`/v1/sweeps/${tradeoff.sweep_id}/recommendation${query({
      scene: tradeoff.scene, device: tradeoff.device, ...asked })}`);
    const text = JSON.stringify([answer, tradeoff.points]);
    if (turn !== latest || text === shown) return;
    shown = text;
    fill(box, answer.answer === "settings" ? found(answer, tradeoff, choose) : none(answer, tradeoff, choose));
  } catch (error) {
    if (turn !== latest) return;
    shown = null;
    fill(box, problem(error));
  }
}

// A predicted choice was never measured and has no picture.
function lookAt(choice, tradeoff, choose, words) {
  const point = tradeoff.points.find((one) => one.configuration_id === choice.configuration_id);
  return point && el("button", {
    type: "button", class: "link", "data-key": `look-${words}`, onclick: () => choose(point.configuration_id),
  }, words);
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

function found(answer, tradeoff, choose) {
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
    lookAt(answer, tradeoff, choose, "See its picture"),
    answer.why.length > 0 && [el("h3", {}, "Why"), el("ul", {}, answer.why.map((reason) => el("li", {}, reason)))],
    next && [el("h3", {}, "Runner-up"), option(next, kind, tradeoff, choose, "See the runner-up's picture")],
    el("details", {}, el("summary", {}, "All settings"),
      el("pre", { tabindex: "0" }, JSON.stringify(answer.settings, null, 2))),
  ];
}

function option(choice, kind, tradeoff, choose, words) {
  return el("p", {}, el("strong", {}, nameOf(choice)), `: ${costs(choice, kind)}, difference ${interval(choice.difference)}. `,
    choice.misses && el("span", { class: "detail" }, `Misses: ${choice.misses.replace(/\.?$/, ".")} `),
    lookAt(choice, tradeoff, choose, words));
}

function none(answer, tradeoff, choose) {
  const { energy_quality: kind, nearest } = answer;
  return [
    el("p", { class: "answer none" }, "No setting meets this budget and the limit."),
    answer.why.length > 0 && el("ul", {}, answer.why.map((reason) => el("li", {}, reason))),
    nearest.length > 0 && [el("h3", {}, nearest.length > 1 ? "The nearest two" : "The nearest"),
      nearest.map((choice, index) => option(choice, kind, tradeoff, choose, `See picture ${index + 1}`))],
    quiet("Raise the budget, or submit a sweep that reaches further down: ", code("joulebox sweep submit FILE.toml"), "."),
  ];
}
