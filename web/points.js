// The points of a trade-off as a table: the chart's twin for keyboards, screen readers and copying.

import { chip, el, fill } from "/assets/dom.js";
import { number, quality } from "/assets/format.js";

const STANDING = { "on the front": "done", "on the front, not confirmed": "paused" };

// `rows` are those of the chart; `limit` is in the unit of its y axis. Drawn only while somebody looks.
export function showPoints(box, details, { rows, head, limit, chosen }, choose) {
  const draw = () => { if (details.open) fill(box, table(rows, head, limit, chosen, choose)); };
  details.ontoggle = draw;
  draw();
}

function table(rows, head, limit, chosen, choose) {
  const energy = head.energy_quality !== "time_only";
  const titles = ["Settings", energy && `Energy [${quality(head.energy_quality).unit}]`, "Time", "Difference", "Judgement"].filter(Boolean);
  const sorted = [...rows].filter((row) => row.shown).sort((one, other) => one.x - other.x);
  return el("div", { class: "scroller", tabindex: "0", role: "region", "aria-label": "Table of points" }, el("table", {},
    el("caption", { class: "unseen" }, "Settings with their cost and difference, cheapest first"),
    el("thead", {}, el("tr", {}, titles.map((title) => el("th", { scope: "col" }, title)))),
    el("tbody", {}, sorted.map((row) => el("tr", { class: row.configuration_id === chosen ? "chosen" : null },
      el("th", { scope: "row" }, el("button", {
        type: "button", class: "link", "data-key": `point-${row.configuration_id}`,
        "aria-pressed": String(row.configuration_id === chosen), onclick: () => choose(row.configuration_id),
      }, row.label)),
      energy && el("td", {}, row.energy), el("td", {}, row.time), el("td", {}, row.difference),
      el("td", {}, row.y <= limit ? "within the limit" : "beyond the limit", " ",
        STANDING[row.standing] && chip(STANDING[row.standing], row.standing),
        row.fragile && chip("failed", "fragile", row.fragile)))))));
}

export const told = (rows, limit) =>
  `${rows.length} settings; ${rows.filter((row) => row.y <= limit).length} stay within the limit of ${number(limit)}. The table below has the numbers.`;
