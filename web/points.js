// The points of a trade-off as a table: the chart's twin for keyboards, screen readers and copying.

import { el, fill } from "/assets/dom.js";
import { interval, quality, settingsText } from "/assets/format.js";

export const nameOf = (point) => point.label || settingsText(point.changed);
export const verdict = (point) =>
  ({ true: "within the limit", false: "beyond the limit" })[point.acceptable] ?? "no difference yet";

export function showPoints(box, tradeoff, chosen, choose) {
  const { unit } = quality(tradeoff.energy_quality);
  const energy = tradeoff.energy_quality !== "time_only";
  const cost = (point) => (energy ? point.energy_j : point.time_s)?.value ?? Infinity;
  const points = [...tradeoff.points].sort((a, b) => cost(a) - cost(b));
  fill(box, el("div", { class: "scroller", tabindex: "0", role: "region", "aria-label": "Table of points" },
    el("table", {},
      el("caption", { class: "unseen" }, "Settings with their cost and difference, cheapest first"),
      el("thead", {}, el("tr", {},
        ["Settings", energy && `Energy [${unit}]`, "Time [s]", "Difference", "Judgement"].filter(Boolean)
          .map((title) => el("th", { scope: "col" }, title)))),
      el("tbody", {}, points.map((point) => el("tr", { class: point.configuration_id === chosen ? "chosen" : null },
        el("th", { scope: "row" }, el("button", {
          type: "button", class: "link", "data-key": `point-${point.configuration_id}`,
          "aria-pressed": String(point.configuration_id === chosen), onclick: () => choose(point.configuration_id),
        }, nameOf(point))),
        energy && el("td", {}, interval(point.energy_j)),
        el("td", {}, interval(point.time_s)),
        el("td", {}, point.difference ? interval(point.difference) : "not known yet"),
        el("td", {}, verdict(point), isFront(point, energy) ? el("span", { class: "chip done" }, "front") : "")))))));
}

const isFront = (point, energy) => Boolean(energy ? point.on_front?.energy_j : point.on_front?.time_s);
