// The devices in short: name, how it measures energy, when it was last heard of.

import { code, el, fill, quiet } from "/assets/dom.js";
import { ago } from "/assets/format.js";

function method(device) {
  const methods = (device.capabilities?.energy_methods ?? []).filter((one) => one.available);
  const best = methods.find((one) => !/^(none|replay)/.test(one.method)) ?? methods.find((one) => one.method !== "none");
  if (!best) return "time only: no energy source";
  if (/^replay/.test(best.method)) return "replayed joules";
  return best.scope ? `${best.method} (${best.scope})` : best.method;
}

export function showDevices(box, devices) {
  if (!devices.length) {
    fill(box, quiet("No device yet. Make a code with ", code("joulebox device enroll"), ", then on the device run ",
      code(`joulebox-agent enroll --server ${location.origin} --code CODE`), " and ", code("joulebox-agent run"), "."));
    return;
  }
  fill(box, el("ul", { class: "list plain" }, devices.map((device) => el("li", {},
    el("span", { class: "name" }, device.name),
    device.health && device.health !== "good" ? el("span", { class: "chip failed" }, device.health) : null,
    el("span", { class: "detail" }, method(device)),
    el("span", { class: "detail" }, `seen ${ago(device.last_seen_at)}`)))));
}
