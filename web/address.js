// What the page shows lives in the address bar, so that a link reproduces the view.

const KEYS = ["sweep", "scene", "device", "x", "y", "scale", "point", "exposure", "budget", "unit", "images"];

export function readAddress(hash = location.hash) {
  const given = new URLSearchParams(hash.replace(/^#/, ""));
  return Object.fromEntries(KEYS.map((key) => [key, given.get(key) || null]));
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
