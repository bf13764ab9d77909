// What the page shows lives in the address bar, so that a link reproduces the view.

const KEYS = [
  "view", "sweep", "scene", "device",
  "x", "y", "scale", "colour", "only", "predicted", "limit", "budget", "unit", "images", "untried", "point",
  "against", "reference", "test", "mode", "map", "zoom", "at", "exposure", "split",
];
export const VIEWS = ["fleet", "sweep", "compare"];

export function readAddress(hash = location.hash) {
  const given = new URLSearchParams(hash.replace(/^#/, ""));
  const found = Object.fromEntries(KEYS.map((key) => [key, given.get(key) || null]));
  return { ...found, view: VIEWS.includes(found.view) ? found.view : "sweep" };
}

export function addressOf(view) {
  const shown = KEYS.filter((key) => view[key] !== null && view[key] !== undefined && view[key] !== "");
  return `#${new URLSearchParams(shown.map((key) => [key, view[key]]))}`;
}

// `step` leaves an entry for the back button; small changes such as typing replace the present one.
export function writeAddress(view, step) {
  const address = addressOf(view);
  if (address === location.hash) return;
  history[step ? "pushState" : "replaceState"](null, "", address);
}

// The settings by which points are looked at, as the address holds them: name:value,name:value.
export const readOnly = (text) => (text ? text.split(",").map(decodeURIComponent) : []);
export const writeOnly = (chosen) => chosen.map(encodeURIComponent).join(",") || null;
