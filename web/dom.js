// Elements from data. Text goes in as text nodes, never as markup, so nothing a server says can become script.

export function el(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false));
  return node;
}

// Replaces what is inside `node`, and keeps the keyboard where it was: a live update must not steal the focus.
export function fill(node, ...children) {
  const key = node.contains(document.activeElement) ? document.activeElement.dataset.key : undefined;
  node.replaceChildren(...children.flat(Infinity).filter(Boolean));
  if (key) node.querySelector(`[data-key="${CSS.escape(key)}"]`)?.focus({ preventScroll: true });
}

export const quiet = (...words) => el("p", { class: "quiet" }, ...words);
export const code = (text) => el("code", {}, text);
export const problem = (error, retry) =>
  el("div", { class: "error", role: "alert" }, el("p", {}, error.message),
    retry && el("button", { type: "button", onclick: retry }, "Try again"));

export function facts(pairs) {
  return el("dl", { class: "facts" }, pairs.map(([name, value, title]) =>
    el("div", { title }, el("dt", {}, name), el("dd", {}, value))));
}
