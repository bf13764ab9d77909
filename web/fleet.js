// The fleet: each device with what it measures by, how it is, and what an operator should look at.

import { getItems, send } from "/assets/api.js";
import { button, chip, code, copyButton, el, facts, fill, link, problem, quiet } from "/assets/dom.js";
import { ago, clock, number, percent, QUALITY } from "/assets/format.js";

const HEALTH = { good: "done", suspect: "failed", maintenance: "paused", retired: "paused" };
const FLAGS = { suspect: "suspect", other_build: "other build", pictures_disagree: "pictures disagree" };
const opened = new Map(); // device name -> the disagreements that were asked for, kept over live updates
let enrolment = null;

export function showFleet(context) {
  const box = document.getElementById("devices");
  const { known } = context;
  showEnrolment(document.getElementById("enrol"));
  const suspects = known.devices.filter((device) => device.health === "suspect");
  fill(document.getElementById("fleet-words"),
    known.devices.length ? `${known.devices.length} ${known.devices.length === 1 ? "device" : "devices"}` : "",
    suspects.length ? `, ${suspects.length} suspect: look at why, then clear` : "");
  if (!known.devices.length) {
    fill(box, quiet("No device yet. Press “Enrol a device”, or make a code with ", code("joulebox device enroll"),
      ", then on the device run ", code(`joulebox-agent enroll --server ${location.origin} --code CODE`), " and ",
      code("joulebox-agent run"), ". It appears here by itself."));
    return;
  }
  fill(box, el("ul", { class: "devices" }, known.devices.map((device) =>
    el("li", { class: "card" }, one(device, known.fleet.get(device.name), context)))));
}

function one(device, state, context) {
  const said = el("div", { role: "status" });
  const set = (health) => async () => {
    try {
      await send("PATCH", `/v1/devices/${device.id}`, { health });
      await context.refresh();
    } catch (error) { fill(said, problem(error)); }
  };
  const { capabilities } = device;
  return [
    el("div", { class: "card-head" }, el("h3", { class: "name" }, device.name), chip(HEALTH[device.health], device.health),
      device.flags.filter((flag) => flag.code !== "suspect").map((flag) => chip("paused", FLAGS[flag.code], flag.message))),
    device.flags.map((flag) => el("p", { class: flag.code === "suspect" ? "error" : "notice" },
      el("strong", {}, `${FLAGS[flag.code]}. `), flag.message)),
    facts([
      ["Battery", battery(state)],
      ["Energy", energy(device, state), "By what the last result's energy was known"],
      ["Resolution", resolution(state), "How often the source gives a new reading, and how closely energy came out"],
      ["Last control run", control(state), "A sweep's first configuration measured again, beside its first run: how far the device drifted"],
      ["Renderer", capabilities?.renderer ? `${capabilities.renderer.name} ${capabilities.renderer.version}` : "not told yet"],
      ["Machine", capabilities ? `${capabilities.cores} cores, ${capabilities.isa ?? capabilities.machine}, ${capabilities.os}` : "not told yet"],
      ["Seen", device.leased_jobs ? `${ago(device.last_seen_at)}, measuring` : ago(device.last_seen_at)],
    ]),
    el("p", { class: "actions" },
      device.health !== "good" && button("Clear: give it jobs again", `clear-${device.id}`, set("good")),
      device.health === "good" && button("Take out of service", `rest-${device.id}`, set("maintenance"), { class: "quiet-button" })),
    said,
    device.disagreements > 0 && disagreements(device, context),
  ];
}

function battery(state) {
  const told = state?.battery;
  if (!told) return state?.result_at ? "none that the system tells of" : "not known before the first result";
  const charge = told.charge_share !== null ? percent(told.charge_share) : "charge not told";
  const parts = [told.full_j !== null ? `${charge} of ${number(told.full_j / 3600)} Wh` : charge];
  if (told.on_mains !== null) parts.push(told.on_mains ? "on mains" : "on battery");
  return `${parts.join(", ")}, ${ago(state.result_at)}`;
}

function energy(device, state) {
  const methods = (device.capabilities?.energy_methods ?? []).filter((method) => method.available && method.method !== "none");
  const could = methods.map((method) => (method.scope ? `${method.method} (${method.scope})` : method.method)).join(", ");
  const { meter } = state ?? {};
  if (!meter) return could ? `can use ${could}` : "time only: no energy source";
  if (meter.quality === "none") return `time only${could ? `; can use ${could}` : ": no energy source"}`;
  return `${meter.method}${meter.scope ? ` (${meter.scope})` : ""}: ${QUALITY[meter.quality]?.label ?? meter.quality}`;
}

function resolution(state) {
  const { refresh_s: refresh, half_width_share: half } = state?.meter ?? {};
  const parts = [];
  if (refresh) parts.push(`a reading every ${number(refresh)} s`);
  if (half) parts.push(`last energy to ± ${percent(half)}`);
  return parts.join(", ") || "not known";
}

function control(state) {
  const told = state?.control;
  if (!told) return "none yet; a sweep with controls makes them";
  const drift = (ratio) => `${ratio >= 1 ? "+" : "−"}${number(Math.abs(ratio - 1) * 100)} %`;
  const joules = told.energy_ratio === null ? "" : `, energy ${drift(told.energy_ratio)}`;
  return `time ${drift(told.time_ratio)}${joules} (${told.scene}, ${ago(told.at)})`;
}

// Where this device and another made different pictures: asked for when somebody wants to see it.
function disagreements(device, { linkTo }) {
  const list = el("div");
  const show = (items) => fill(list, el("ul", { class: "plain" }, items.map((found) => el("li", {},
    `${found.scene} beside ${found.device === device.name ? found.other_device : found.device}: `,
    found.same_class ? "not the same pixels, although both are of one class" : `99 % of the pixels within ${number(found.p99_jnd)} JND, 1 is allowed`,
    found.image_sha256 && found.other_image_sha256 && [". ", link("Compare the pictures",
      linkTo({ view: "compare", reference: found.other_image_sha256, test: found.image_sha256, point: null, against: null }), `disagree-${found.id}`)]))));
  const load = async () => {
    if (opened.has(device.id)) return show(opened.get(device.id));
    fill(list, quiet("Loading …"));
    try {
      opened.set(device.id, await getItems(`/v1/devices/${device.id}/disagreements`, {}, 50));
      show(opened.get(device.id));
    } catch (error) { fill(list, problem(error, load)); }
    return undefined;
  };
  const known = opened.get(device.id);
  if (known && known.length !== Math.min(50, device.disagreements)) opened.delete(device.id);
  const box = el("details", { open: opened.has(device.id), ontoggle: ({ target }) => { if (target.open) load(); else opened.delete(device.id); } },
    el("summary", { "data-key": `disagreements-${device.id}` }, `${device.disagreements} disagreeing ${device.disagreements === 1 ? "picture" : "pictures"}`), list);
  return box;
}

function showEnrolment(box) {
  if (box.childElementCount) return;
  const answer = el("div", { role: "status" });
  const name = el("input", { id: "device-name", autocomplete: "off", maxlength: "100", placeholder: "its host name", "data-key": "device-name" });
  const make = async (event) => {
    event.preventDefault();
    try {
      enrolment = await send("POST", "/v1/enrollments", name.value.trim() ? { name: name.value.trim() } : {});
      const line = el("pre", { tabindex: "0", "aria-label": "Line for the device's shell" }, enrolment.join);
      fill(answer, el("p", {}, `On the device, run this line; its code works once and until ${clock(Date.parse(enrolment.expires_at))}:`),
        line, el("p", {}, copyButton("Copy the line", "copy-join", enrolment.join, line)),
        quiet("Then start ", code("joulebox-agent run"), ", or ", code("joulebox-agent install-service"), " once and for all. The device appears here by itself."));
    } catch (error) { fill(answer, problem(error)); }
  };
  box.append(el("form", { class: "options", onsubmit: make },
    el("label", { for: "device-name" }, "Name, for the list of codes "), name, el("button", { type: "submit" }, "Enrol a device")), answer);
}
