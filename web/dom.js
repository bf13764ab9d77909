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

export const chip = (kind, words, title) => el("span", { class: `chip ${kind}`, title }, words);
export const button = (words, key, onclick, more = {}) => el("button", { type: "button", "data-key": key, onclick, ...more }, words);
export const link = (words, href, key) => el("a", { href, "data-key": key }, words);

// A button that copies text and says so; where a page may not write to the clipboard it selects the text instead.
export function copyButton(words, key, text, shown) {
  const done = el("span", { class: "detail", role: "status" });
  const copy = async () => {
    try {
      await navigator.clipboard.writeText(text);
      done.textContent = " Copied.";
    } catch {
      getSelection().selectAllChildren(shown);
      done.textContent = " Selected: press Ctrl+C, or Cmd+C on a Mac.";
    }
  };
  return [button(words, key, copy, { class: "quiet-button" }), done];
}

// A <select> with its label; `values` are [value, words] pairs.
export function choice(label, name, values, chosen, onchange) {
  const select = el("select", { name, "data-key": name, onchange: (event) => onchange(event.target.value) },
    values.map(([value, text]) => el("option", { value, selected: String(value) === String(chosen) }, text)));
  return el("label", {}, `${label} `, select);
}
