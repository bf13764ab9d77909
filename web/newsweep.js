// A new sweep from a pasted file: read, previewed and started, each step in the server's own words.

import { send } from "/assets/api.js";
import { button, el, facts, fill, problem, quiet } from "/assets/dom.js";
import { duration, number } from "/assets/format.js";

const EXAMPLE = `name = "photons"
scenes = ["cornell-boxes"]

[axes]
global_photons = [25000, 100000, 250000]
final_gather_rays = [64, 256]`;

export function showNewSweep(box, context) {
  const text = el("textarea", {
    id: "sweep-text", rows: "10", spellcheck: "false", autocapitalize: "off", placeholder: EXAMPLE, required: true, "data-key": "sweep-text",
  });
  const answer = el("div", { id: "preview", role: "status" });
  const form = el("form", {},
    el("label", { for: "sweep-text" }, "Sweep file, TOML or JSON"), text,
    el("p", { class: "hint" }, "Scenes are those this server has; ", el("code", {}, "joulebox sweep submit"), " sends new ones along."),
    el("div", { class: "row" }, el("button", { type: "submit" }, "Preview")), answer);
  text.addEventListener("input", () => fill(answer));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    fill(answer, quiet("Reading it …"));
    try {
      const { definition, notes } = await send("POST", "/v1/sweeps:read", text.value);
      const found = await send("POST", "/v1/sweeps:preview", definition);
      fill(answer, preview(definition, found, notes, () => begin(definition)));
    } catch (error) { fill(answer, problem(error)); }
  });

  // One key for one preview: pressing the button twice makes one sweep.
  async function begin(definition) {
    const key = [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
    try {
      const { id } = await send("POST", "/v1/sweeps", definition, { "Idempotency-Key": key });
      text.value = "";
      fill(answer);
      box.open = false;
      const { refresh, chooseSweep } = context();
      await refresh();
      await chooseSweep(id);
    } catch (error) { fill(answer, problem(error)); }
  }
  box.append(form);
}

function preview(definition, found, notes, begin) {
  const { jobs, time_s: time, energy_j: energy, power_w: power, battery_charges: charges } = found;
  const kinds = [["reference", "reference"], ["noise_floor", "noise floor"], ["control", "control run"]]
    .filter(([kind]) => jobs[kind]).map(([kind, word]) => `, ${jobs[kind]} ${word}${jobs[kind] > 1 ? "s" : ""}`).join("");
  const unknown = "not known: no measured result of these devices yet";
  const start = button(`Start ${definition.name}`, "start-sweep", () => { start.disabled = true; begin(); });
  return [
    el("h3", {}, `Preview of ${definition.name}`),
    notes.map((note) => el("p", { class: "notice" }, note)),
    facts([
      ["Configurations", number(found.configurations)],
      ["Jobs", `${jobs.total}: ${jobs.measure} to measure${kinds}`],
      ["Time on each device", `${duration(time.low)} to ${duration(time.high)}`],
      ["Energy", energy === null ? unknown : `${number(energy)} J at ${number(power)} W`],
      ["Battery charges", charges === null ? "not known: no battery told its capacity yet" : `${number(charges)}, from 90 to 30 % each`],
      ["Devices", found.devices],
    ]),
    start,
  ];
}
