// Ties the page together: the address says what to show, the server says what there is, three views draw it.

import { VIEWS, addressOf, readAddress, writeAddress } from "/assets/address.js";
import { getItems, keepToken, listen, onTokenWanted, token } from "/assets/api.js";
import { chartLibrary } from "/assets/chart.js";
import { showCompare } from "/assets/compare.js";
import { fill, problem, quiet } from "/assets/dom.js";
import { showFleet } from "/assets/fleet.js";
import { showNewSweep } from "/assets/newsweep.js";
import { staleSweep, showSweepView } from "/assets/sweep.js";
import { showSweeps } from "/assets/sweeps.js";

const at = (id) => document.getElementById(id);
const known = { sweeps: null, devices: null, fleet: new Map() };
const VIEW = { fleet: showFleet, sweep: showSweepView, compare: showCompare };
let view = readAddress();

// --- what is shown --------------------------------------------------------------------------------------------

// What a view gets: the address as an object, what is known, and how to go on from here.
const context = () => ({ view, known, change, refresh, chooseSweep, linkTo });

function change(patch, step = false) {
  view = { ...view, ...patch };
  writeAddress(view, step);
  return show();
}

const linkTo = (patch) => addressOf({ ...view, ...patch });
const OF_A_SWEEP = Object.fromEntries(
  ["scene", "device", "point", "against", "reference", "test", "x", "colour", "only", "limit", "exposure", "predicted"].map((key) => [key, null]));
const chooseSweep = (id) => change({ ...OF_A_SWEEP, view: "sweep", sweep: id }, true);

async function show() {
  for (const name of VIEWS) {
    at(`view-${name}`).hidden = name !== view.view;
    const link = at(`to-${name}`);
    link.href = linkTo({ view: name });
    link.toggleAttribute("aria-current", name === view.view);
    if (name === view.view) link.setAttribute("aria-current", "page");
  }
  if (!known.sweeps) return view.view === "sweep" && view.sweep ? showSweepView(context()) : undefined; // no need to wait for the lists
  if (!view.sweep && known.sweeps.length) {
    view.sweep = known.sweeps[0].id;
    writeAddress(view, false);
  }
  showSweeps(at("sweeps"), context());
  return VIEW[view.view](context());
}

// --- fresh data -------------------------------------------------------------------------------------------------

async function refresh() {
  try {
    const [sweeps, devices, fleet] = await Promise.all(["/v1/sweeps", "/v1/devices", "/v1/fleet"].map((path) => getItems(path)));
    if (known.sweeps) staleSweep();
    Object.assign(known, { sweeps, devices, fleet: new Map(fleet.map((state) => [state.device, state])) });
  } catch (error) {
    if (!known.sweeps) {
      for (const id of ["sweeps", "overview", "devices", "compare"]) {
        fill(at(id), id === "sweeps" ? problem(error, () => start()) : quiet("It shows when the server answers."));
      }
    }
    throw error;
  }
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

// --- signing in ---------------------------------------------------------------------------------------------------

let asking = null; // several questions may want a token at once; one dialog answers them all
onTokenWanted(({ role, refused }) => (asking ??= new Promise((resolve) => {
  const dialog = at("sign-in");
  at("sign-in-role").textContent = role;
  at("sign-in-command").textContent = `joulebox token create --role ${role}`;
  at("sign-in-error").hidden = !refused;
  at("sign-in-error").textContent = refused ? `That token did not open the door: ${refused}` : "";
  dialog.returnValue = "";
  dialog.addEventListener("close", () => {
    asking = null;
    if (dialog.returnValue === "signed-in") keepToken(at("token").value.trim());
    at("token").value = "";
    resolve(dialog.returnValue === "signed-in");
  }, { once: true });
  dialog.showModal();
})));

// --- start ----------------------------------------------------------------------------------------------------

showNewSweep(at("new-sweep"), context);
addEventListener("popstate", () => { view = readAddress(); show(); });
addEventListener("hashchange", () => { if (addressOf(readAddress()) !== addressOf(view)) { view = readAddress(); show(); } });

let listening = false;
async function start() {
  await refresh().catch(() => {});
  if (known.sweeps && token()) at("connection").title = "Signed in with the token of this tab";
  if (!listening) {
    listening = true;
    listen({ onEvent: refreshSoon, onState: showConnection, onPoll: refresh });
  }
}
if (view.view === "sweep") chartLibrary().catch(() => {});
show();
start();
