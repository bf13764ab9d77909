// Handles that are dragged, or moved with the arrow keys: a line of a chart, the edge between two pictures.

import { el } from "/assets/dom.js";

// A handle for a value along "x" or "y". `place(value)` gives its pixel inside the stage or null, `read(pixel)` the
// value there; `told(value)` says it in words. onMove runs while it moves, onDone when it rests.
export function handle({ axis, label, place, read, told, onMove, onDone }) {
  let value = null;
  const node = el("div", {
    class: `handle ${axis}`, role: "slider", tabindex: "0", hidden: true, "aria-label": label, "data-key": `handle-${label}`,
    "aria-orientation": axis === "x" ? "horizontal" : "vertical",
  });

  function show(next) {
    value = next;
    const pixel = next === null || next === undefined ? null : place(next);
    node.hidden = pixel === null;
    if (pixel === null) return;
    node.style[axis === "x" ? "left" : "top"] = `${pixel}px`;
    node.setAttribute("aria-valuenow", Number(next.toPrecision(3)));
    node.setAttribute("aria-valuetext", told(next));
  }

  function move(next, done) {
    if (next === null || !Number.isFinite(next)) return;
    show(next);
    (done ? onDone : onMove)?.(next);
  }

  const at = (event) => {
    const stage = node.parentElement.getBoundingClientRect();
    return read(axis === "x" ? event.clientX - stage.left : event.clientY - stage.top);
  };
  node.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    event.stopPropagation();
    node.focus({ preventScroll: true });
    node.setPointerCapture(event.pointerId);
  });
  node.addEventListener("pointermove", (event) => { if (node.hasPointerCapture(event.pointerId)) move(at(event), false); });
  for (const end of ["pointerup", "pointercancel"]) {
    node.addEventListener(end, (event) => {
      if (!node.hasPointerCapture(event.pointerId)) return;
      node.releasePointerCapture(event.pointerId);
      move(value, true);
    });
  }
  node.addEventListener("keydown", (event) => {
    const forward = axis === "x" ? 1 : -1; // up is a smaller pixel and a larger value
    const steps = { ArrowRight: 4, ArrowLeft: -4, ArrowUp: 4 * forward, ArrowDown: -4 * forward, PageUp: 24 * forward, PageDown: -24 * forward };
    const step = steps[event.key];
    if (step === undefined || value === null) return;
    event.preventDefault();
    move(read(place(value) + step), true);
  });
  return { node, show };
}
