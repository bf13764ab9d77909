// Panes that look at the same place of a picture: zoom, drag, a cursor on one pixel, by hand or by keyboard.

import { el } from "/assets/dom.js";

export const ZOOMS = [1, 2, 4, 8, 16];

// `sizeOf()` gives {width, height} of the pictures or null; onChange({zoom, x, y}) runs when somebody moves.
export function panes({ sizeOf, onChange }) {
  const place = { zoom: null, x: null, y: null }; // zoom null: as large as fits; x, y: the pixel under the cursor
  let all = [];

  const fitting = (pane) => {
    const size = sizeOf();
    const most = Math.min(pane.clientWidth / size.width, (window.innerHeight * 0.7) / size.height);
    return most >= 1 ? Math.floor(most) : most;
  };
  const zoomOf = (pane) => place.zoom ?? fitting(pane);

  // Top left corner of the picture in the pane [CSS px]: in the middle where it fits, else the cursor stays in view.
  function corner(pane) {
    const { width, height } = sizeOf();
    const zoom = zoomOf(pane);
    return [["x", width, pane.clientWidth], ["y", height, pane.clientHeight]].map(([name, size, room]) => {
      if (size * zoom <= room) return Math.floor((room - size * zoom) / 2);
      const middle = place[name] ?? size / 2;
      return Math.round(Math.min(0, Math.max(room - size * zoom, room / 2 - (middle + 0.5) * zoom)));
    });
  }

  // `layers` are [picture, part] pairs, drawn one over the other, each left of `part` of the pane's width.
  function paint(pane) {
    const ratio = window.devicePixelRatio || 1;
    const size = sizeOf();
    if (!size || !pane.clientWidth) return;
    const zoom = zoomOf(pane);
    const height = Math.round(Math.min(size.height * zoom, Math.max(240, window.innerHeight * 0.7)));
    if (pane.clientHeight !== height) pane.style.height = `${height}px`;
    Object.assign(pane, { width: Math.round(pane.clientWidth * ratio), height: Math.round(height * ratio) });
    const context = pane.getContext("2d");
    context.imageSmoothingEnabled = zoom < 1;
    const [left, top] = corner(pane);
    for (const [picture, part] of pane.layers()) {
      context.save();
      context.beginPath();
      context.rect(0, 0, pane.width * part, pane.height);
      context.clip();
      context.clearRect(0, 0, pane.width, pane.height);
      if (picture) context.drawImage(picture, left * ratio, top * ratio, size.width * zoom * ratio, size.height * zoom * ratio);
      context.restore();
    }
    if (place.x === null || zoom < 2) return;
    for (const [colour, grow] of [["#000", 1.5], ["#fff", 0.5]]) {
      context.strokeStyle = colour;
      context.lineWidth = ratio;
      context.strokeRect((left + place.x * zoom - grow) * ratio, (top + place.y * zoom - grow) * ratio, (zoom + 2 * grow) * ratio, (zoom + 2 * grow) * ratio);
    }
  }

  function pixelAt(pane, event) {
    const box = pane.getBoundingClientRect();
    const [left, top] = corner(pane);
    const zoom = zoomOf(pane);
    return [Math.floor((event.clientX - box.left - left) / zoom), Math.floor((event.clientY - box.top - top) / zoom)];
  }

  function moveTo(x, y) {
    const { width, height } = sizeOf();
    Object.assign(place, { x: Math.min(Math.max(x, 0), width - 1), y: Math.min(Math.max(y, 0), height - 1) });
    onChange(place);
  }

  function zoomBy(pane, steps) {
    const now = ZOOMS.findLastIndex((zoom) => zoom <= zoomOf(pane));
    place.zoom = ZOOMS[Math.min(Math.max(now + steps, 0), ZOOMS.length - 1)];
    onChange(place);
  }

  function make(kind, words, layers) {
    const pane = el("canvas", { class: "pane", tabindex: "0", role: "img", "aria-label": words, "data-pane": kind, "data-key": `pane-${kind}` });
    pane.layers = layers;
    let from = null;
    pane.addEventListener("pointerdown", (event) => {
      if (!sizeOf()) return;
      from = { x: event.clientX, y: event.clientY, place: { ...place }, corner: corner(pane), moved: false };
      pane.setPointerCapture(event.pointerId);
    });
    pane.addEventListener("pointermove", (event) => {
      if (!from) return;
      const [dx, dy] = [event.clientX - from.x, event.clientY - from.y];
      from.moved ||= Math.hypot(dx, dy) > 4;
      if (!from.moved) return;
      const zoom = zoomOf(pane);
      const middle = [pane.clientWidth, pane.clientHeight].map((room, index) => (room / 2 - from.corner[index] - [dx, dy][index]) / zoom);
      moveTo(Math.round(middle[0] - 0.5), Math.round(middle[1] - 0.5));
    });
    pane.addEventListener("pointerup", (event) => {
      if (from && !from.moved) moveTo(...pixelAt(pane, event));
      from = null;
    });
    pane.addEventListener("pointercancel", () => { from = null; });
    pane.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && document.activeElement !== pane) return; // the page scrolls unless somebody chose the picture
      event.preventDefault();
      zoomBy(pane, event.deltaY < 0 ? 1 : -1);
    }, { passive: false });
    pane.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
      if (!sizeOf() || (!steps && !["+", "=", "-"].includes(event.key))) return;
      event.preventDefault();
      if (!steps) return zoomBy(pane, event.key === "-" ? -1 : 1);
      const size = sizeOf();
      const far = event.shiftKey ? 10 : 1;
      return moveTo((place.x ?? size.width >> 1) + far * steps[0], (place.y ?? size.height >> 1) + far * steps[1]);
    });
    return pane;
  }

  return {
    place,
    make,
    show(shown) { all = shown; },
    paint() { if (sizeOf()) all.forEach(paint); },
    // Where the picture begins and ends in the first pane [CSS px], for a line across it.
    edges() { const [left] = corner(all[0]); return [left, left + sizeOf().width * zoomOf(all[0])]; },
  };
}
