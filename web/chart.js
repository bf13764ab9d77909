// Vega-Lite specs from the server, drawn without eval and in the page's own colours.

import { el, fill, problem, quiet } from "/assets/dom.js";

let library = null;
export const chartLibrary = () => (library ??= import("/assets/vega.js").catch((error) => {
  library = null;
  throw new Error(`The chart library did not load (${error.message}). Reload the page; if it stays, look at the server's log.`);
}));

const MANY_POINTS = 400; // from here on one canvas is quicker than a shape for each

// The spec is drawn for white paper. Its halos, ink, muted tone, grid, limit and budget (server: analysis/palette.py)
// become the page's own, which can be read on a dark screen as well; the colours of the settings stay as they are.
const PAPER_COLOURS = {
  "#ffffff": "--card", "#1f2933": "--ink", "#7b8794": "--soft", "#e4e7eb": "--line", "#009e73": "--limit", "#d55e00": "--budget",
};

function inPageColours({ datasets, usermeta, ...spec }) {
  const style = getComputedStyle(document.documentElement);
  const recoloured = JSON.parse(JSON.stringify(spec, function inkFor(key, value) {
    const halo = this.type === "text"; // a point keeps its white edge: dark colours need it most on a dark screen
    const name = value === "#ffffff" && !halo ? null : PAPER_COLOURS[value];
    return name ? style.getPropertyValue(name).trim() : value;
  }));
  const config = { ...recoloured.config, background: "transparent", font: getComputedStyle(document.body).fontFamily };
  const screen = document.documentElement.clientWidth;
  if (screen < 600) {
    config.legend = { ...config.legend, columns: 2, labelLimit: 190, labelFontSize: 11, layout: { bottom: { direction: "vertical" } } };
    config.title = { ...config.title, limit: screen - 60 };
  }
  return { ...recoloured, background: "transparent", config, ...(datasets ? { datasets } : {}) };
}

// One chart in `box`. show(text, description) draws when the spec has changed; mark({x, y}) rings a point; lines are
// handles (lines.js) that lie over it; onDrawn runs after each drawing.
export function chartIn(box, { onPick, onDrawn, lines = [] } = {}) {
  let drawn = null;
  let view = null;
  let marked = null;
  let described = "";
  let latest = 0;
  const ring = el("span", { class: "ring", hidden: true, "aria-hidden": "true" });

  const place = () => {
    const at = view && marked && pixelOf(view, marked);
    ring.hidden = !at;
    if (at) { ring.style.left = `${at[0]}px`; ring.style.top = `${at[1]}px`; }
    if (!view) return;
    box.style.setProperty("--plot-top", `${originOf(view, "y")}px`);
    onDrawn?.();
  };

  async function show(text, description) {
    if (text === drawn) return place();
    drawn = text;
    described = description;
    const turn = ++latest;
    if (!view) fill(box, quiet("Drawing the chart …"));
    try {
      const { vegaEmbed } = await chartLibrary();
      if (turn !== latest) return undefined;
      const spec = inPageColours(JSON.parse(text));
      const canvas = el("div", { class: "canvas", "aria-hidden": "true" }); // until it is one picture with a description
      const stage = el("div", { class: "stage" }, canvas, ring, lines);
      fill(box, stage); // in the page before it is drawn, because its width is its container's
      const result = await vegaEmbed(canvas, spec, {
        mode: "vega-lite", ast: true, actions: false, defaultStyle: false,
        renderer: spec.datasets?.points?.length > MANY_POINTS ? "canvas" : "svg",
        tooltip: { disableDefaultStyle: true, theme: "joulebox" },
      });
      if (turn !== latest) return result.finalize();
      view?.finalize();
      view = result.view;
      for (const picture of canvas.children) picture.setAttribute("aria-hidden", "true"); // marks are read from the table
      canvas.removeAttribute("aria-hidden");
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", description);
      view.addEventListener("click", (event, item) => onPick?.(item?.datum ?? null, nearestIn(view, event)));
      view.addResizeListener(() => requestAnimationFrame(place));
    } catch (error) {
      drawn = null;
      fill(box, problem(error));
    }
    return place();
  }

  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    if (!drawn) return;
    const text = drawn;
    drawn = null;
    show(text, described);
  });

  return {
    show,
    mark(point) { marked = point; place(); },
    say(...nodes) { latest += 1; drawn = null; view?.finalize(); view = null; fill(box, ...nodes); },
    drawn: () => Boolean(view),
    set(name, value) { view?.signal(name, value).runAsync(); },
    pixel: (axis, value) => axisPixel(view, axis, value),
    value: (axis, pixel) => axisValue(view, axis, pixel),
  };
}

const originOf = (view, axis) => view.origin()[axis === "x" ? 0 : 1] + view.padding()[axis === "x" ? "left" : "top"];

// Where a value lies inside the chart's box [px], and back; null outside the axis or without such a scale.
function axisPixel(view, axis, value) {
  try {
    const scale = view.scale(axis);
    const [low, high] = scale.domain();
    if (!(value >= low && value <= high)) return null;
    return originOf(view, axis) + scale(value);
  } catch { return null; }
}

function axisValue(view, axis, pixel) {
  try {
    const scale = view.scale(axis);
    const [start, end] = scale.range();
    const inside = Math.min(Math.max(pixel - originOf(view, axis), Math.min(start, end)), Math.max(start, end));
    const [low, high] = scale.domain();
    return Math.min(Math.max(scale.invert(inside), low || high / 1e4), high);
  } catch { return null; }
}

function pixelOf(view, { x, y }) {
  const at = [axisPixel(view, "x", x), axisPixel(view, "y", y)];
  return at.every((pixel) => pixel !== null) ? at : null;
}

// For fingers: finds the point nearest to a click among `points` ({x, y}), if within `reach` pixels.
function nearestIn(view, event) {
  const box = view.container().getBoundingClientRect();
  const [x, y] = [event.clientX - box.left, event.clientY - box.top];
  return (points, reach = 24) => {
    let best = null;
    for (const point of points) {
      const at = pixelOf(view, point);
      const distance = at ? Math.hypot(at[0] - x, at[1] - y) : Infinity;
      if (distance <= (best?.distance ?? reach)) best = { point, distance };
    }
    return best?.point ?? null;
  };
}
