// The list of sweeps, and the head of the one that is shown: state, progress, what failed and what to do.

import { code, el, fill, problem, quiet } from "/assets/dom.js";
import { ago, quality } from "/assets/format.js";

const STATES = { running: "running", done: "done", failed: "failed", paused: "paused", cancelled: "cancelled" };

export function progressBar(jobs, label) {
  const share = jobs.total ? jobs.done / jobs.total : 0;
  const bar = el("div", {
    class: "progress", role: "progressbar", "aria-label": label, "aria-valuemin": "0",
    "aria-valuemax": jobs.total, "aria-valuenow": jobs.done, "aria-valuetext": progressText(jobs),
  });
  for (const [name, count] of [["done", jobs.done], ["failed", jobs.failed], ["leased", jobs.leased]]) {
    if (!count) continue;
    const part = el("span", { class: name });
    part.style.width = `${(100 * count) / jobs.total}%`; // through the object model: style attributes are not allowed
    bar.append(part);
  }
  bar.classList.toggle("complete", share === 1);
  return bar;
}

export function progressText(jobs) {
  const parts = [`${jobs.done} of ${jobs.total} jobs done`];
  if (jobs.leased) parts.push(`${jobs.leased} running`);
  if (jobs.failed) parts.push(`${jobs.failed} failed`);
  if (jobs.cancelled) parts.push(`${jobs.cancelled} cancelled`);
  return parts.join(", ");
}

const stateChip = (state) => el("span", { class: `chip ${state}` }, STATES[state] ?? state);

export function showSweeps(box, sweeps, chosen, choose) {
  if (!sweeps.length) {
    fill(box, quiet("No sweep yet. Write one down and submit it with ", code("joulebox sweep submit FILE.toml"),
      "; or run ", code("make demo"), " for a small one. It appears here by itself."));
    return;
  }
  fill(box, el("ul", { class: "list" }, sweeps.map((sweep) => el("li", {},
    el("button", {
      type: "button", class: "pick", "data-key": `sweep-${sweep.id}`, "aria-current": sweep.id === chosen ? "true" : null,
      onclick: () => choose(sweep.id),
    },
    el("span", { class: "name" }, sweep.name), stateChip(sweep.state),
    el("span", { class: "detail" }, `${progressText(sweep.jobs)} · ${ago(sweep.created_at)}`),
    progressBar(sweep.jobs, `Progress of ${sweep.name}`))))));
}

function choice(label, name, values, chosen, choose) {
  const select = el("select", { name, "data-key": name, onchange: (event) => choose({ [name]: event.target.value, point: null }) },
    values.map(([value, text]) => el("option", { value, selected: value === chosen }, text)));
  return el("label", {}, `${label} `, select);
}

export function showOverview(box, { sweep, tradeoff, failed }, choose) {
  const scenes = tradeoff?.scenes ?? sweep.scenes ?? [];
  const devices = tradeoff?.devices ?? sweep.devices ?? [];
  fill(box,
    el("div", { class: "card-head" },
      el("h2", {}, sweep.name), stateChip(sweep.state)),
    el("div", { class: "live" }, progressBar(sweep.jobs, "Progress of this sweep"),
      el("span", { class: "detail" }, progressText(sweep.jobs),
        sweep.differences_pending ? `, ${sweep.differences_pending} pictures being compared` : "")),
    el("form", { class: "options", "aria-label": "Scene and device", onsubmit: (event) => event.preventDefault() },
      scenes.length > 0 && choice("Scene", "scene", scenes.map((name) => [name, name]), tradeoff?.scene, choose),
      devices.length > 0 && choice("Device", "device", devices.map((name) => [name, name]), tradeoff?.device, choose)),
    tradeoff && honesty(tradeoff),
    failed.length > 0 && failures(sweep, failed));
}

function honesty(tradeoff) {
  const floor = tradeoff.noise_floor;
  const kind = tradeoff.energy_quality;
  return el("div", { class: "words" },
    kind !== "measured" && el("p", { class: `notice ${kind}` },
      el("strong", {}, `${quality(kind).label}. `), quality(kind).explanation),
    floor?.too_noisy && el("p", { class: "notice" },
      el("strong", {}, "The reference is noisy. "),
      `Rendered again with another seed it already differs from itself by ${Math.round(100 * floor.share_of_limit)} % of the `
      + "limit, so small differences mean little. Give the reference more samples and submit again."));
}

function failures(sweep, failed) {
  const counts = new Map();
  for (const { reason } of failed) counts.set(reason, (counts.get(reason) ?? 0) + 1);
  return el("div", { class: "error" },
    el("p", {}, el("strong", {}, `${failed.length} ${failed.length === 1 ? "job" : "jobs"} failed. `),
      "The rest of the sweep is good. Put the cause right, then ", code(`joulebox sweep retry ${sweep.id}`), "."),
    el("ul", {}, [...counts].map(([reason, count]) => el("li", {}, reason || "no reason given", count > 1 ? ` (${count} jobs)` : ""))),
);
}

export const showOverviewError = (box, error, retry) => fill(box, problem(error, retry));
