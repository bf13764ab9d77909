// The list of sweeps, and the head of the one that is shown: state, progress, what failed and what to do.

import { send } from "/assets/api.js";
import { button, chip, choice, code, el, fill, problem, quiet } from "/assets/dom.js";
import { ago, clock, duration, quality } from "/assets/format.js";

export function progressBar(jobs, label) {
  const bar = el("div", {
    class: "progress", role: "progressbar", "aria-label": label, "aria-valuemin": "0",
    "aria-valuemax": jobs.total, "aria-valuenow": jobs.done, "aria-valuetext": progressText(jobs),
  });
  for (const name of ["done", "failed", "leased"]) {
    if (!jobs[name]) continue;
    const part = el("span", { class: name });
    part.style.width = `${(100 * jobs[name]) / jobs.total}%`; // through the object model: style attributes are not allowed
    bar.append(part);
  }
  return bar;
}

export function progressText(jobs) {
  const parts = [`${jobs.done} of ${jobs.total} jobs done`];
  if (jobs.leased) parts.push(`${jobs.leased} running`);
  if (jobs.failed) parts.push(`${jobs.failed} failed`);
  if (jobs.cancelled) parts.push(`${jobs.cancelled} cancelled`);
  return parts.join(", ");
}

export function showSweeps(box, { view, known, chooseSweep }) {
  if (!known.sweeps.length) {
    fill(box, quiet("No sweep yet. Paste one below, or submit one with ", code("joulebox sweep submit FILE.toml"),
      "; or run ", code("make demo"), " for a small one. It appears here by itself."));
    return;
  }
  fill(box, el("ul", { class: "list" }, known.sweeps.map((sweep) => el("li", {},
    el("button", {
      type: "button", class: "pick", "data-key": `sweep-${sweep.id}`, "aria-current": [sweep.id, sweep.name].includes(view.sweep) ? "true" : null,
      onclick: () => chooseSweep(sweep.id),
    },
    el("span", { class: "name" }, sweep.name), chip(sweep.state, sweep.state),
    el("span", { class: "detail" }, `${progressText(sweep.jobs)} · ${ago(sweep.created_at)}`),
    progressBar(sweep.jobs, `Progress of ${sweep.name}`))))));
}

// The head of a sweep. `head` is what its chart says of the trade-off, null while that is not known.
export function showOverview(box, { sweep, head, failed, progress }, { change, refresh }) {
  const scenes = head?.scenes ?? sweep.scenes;
  const devices = head?.devices ?? sweep.devices;
  const choose = (name) => (value) => change({ [name]: value, point: null, only: null }, true);
  const said = el("div", { role: "status" });
  const act = (action) => async () => {
    try {
      await send("PATCH", `/v1/sweeps/${sweep.id}`, { action });
      await refresh();
    } catch (error) { fill(said, problem(error)); }
  };
  fill(box,
    el("div", { class: "card-head" }, el("h2", {}, sweep.name), chip(sweep.state, sweep.state),
      el("span", { class: "actions" },
        sweep.state === "running" && button("Pause", "pause", act("pause"), { class: "quiet-button" }),
        sweep.state === "paused" && button("Resume", "resume", act("resume"), { class: "quiet-button" }))),
    el("div", { class: "live" }, progressBar(sweep.jobs, "Progress of this sweep"),
      el("span", { class: "detail" }, progressText(sweep.jobs),
        sweep.differences_pending ? `, ${sweep.differences_pending} pictures being compared` : "")),
    progress && expected(progress),
    said,
    el("form", { class: "options", "aria-label": "Scene and device", onsubmit: (event) => event.preventDefault() },
      scenes.length > 0 && choice("Scene", "scene", scenes.map((name) => [name, name]), head?.scene, choose("scene")),
      devices.length > 0 && choice("Device", "device", devices.map((name) => [name, name]), head?.device, choose("device"))),
    head && honesty(head),
    failed.length > 0 && failures(sweep, failed, refresh));
}

function expected({ remaining_s: left, reason, last_result_at: last }) {
  const moved = last ? ` Last result ${ago(last)}.` : "";
  if (!left) return el("p", { class: "detail expected" }, `Expected end: not known, ${reason}.${moved}`);
  const end = (seconds) => clock(Date.now() + 1000 * seconds);
  return el("p", { class: "detail expected" },
    `Expected end: ${end(left.value)}, in ${duration(left.value)} (${end(left.low)} to ${end(left.high)}).${moved}`);
}

function honesty(head) {
  const floor = head.noise_floor;
  const kind = head.energy_quality;
  return el("div", { class: "words" },
    kind !== "measured" && head.point_count > 0 && el("p", { class: `notice ${kind}` },
      el("strong", {}, `${quality(kind).label}. `), quality(kind).explanation),
    floor?.too_noisy && el("p", { class: "notice" },
      el("strong", {}, "The reference is noisy. "),
      `Rendered again with another seed it already differs from itself by ${Math.round(100 * floor.share_of_limit)} % of the `
      + "limit, so small differences mean little. Give the reference more samples and submit again."));
}

function failures(sweep, failed, refresh) {
  const counts = new Map();
  for (const { reason } of failed) counts.set(reason, (counts.get(reason) ?? 0) + 1);
  const said = el("div", { role: "status" });
  const retry = async () => {
    try {
      const { retried } = await send("POST", `/v1/sweeps/${sweep.id}:retry-failed`);
      fill(said, quiet(`${retried} ${retried === 1 ? "job waits" : "jobs wait"} for a device again.`));
      await refresh();
    } catch (error) { fill(said, problem(error)); }
  };
  return el("div", { class: "error" },
    el("p", {}, el("strong", {}, `${failed.length} ${failed.length === 1 ? "job" : "jobs"} failed. `),
      "The rest of the sweep is good. Put the cause right, then retry them here or with ",
      code(`joulebox sweep retry ${sweep.id}`), "."),
    el("ul", {}, [...counts].map(([reason, count]) => el("li", {}, reason || "no reason given", count > 1 ? ` (${count} jobs)` : ""))),
    button(failed.length === 1 ? "Retry the failed job" : `Retry the ${failed.length} failed jobs`, "retry-failed", retry), said);
}
