// Elements in one call, for HTML and SVG. No style attributes: the content security policy forbids them.

const SVG = "http://www.w3.org/2000/svg";

/** An HTML element. Props: `class`, `style` (an object), `onclick` etc., `dataset`, properties, else attributes. */
export const h = (tag, props, ...children) => filled(document.createElement(tag), props, children);

/** The same for SVG; every prop that is no listener is an attribute. */
export const svg = (tag, props, ...children) => filled(document.createElementNS(SVG, tag), props, children);

/** A button of words. */
export const button = (words, onclick, kind = "", props = {}) =>
  h("button", { type: "button", class: `button ${kind}`.trim(), onclick, ...props }, words);

/** Put other children into an element. Texts, elements, arrays of them; null and false are left out. */
export function replace(root, ...children) {
  root.replaceChildren(...nodes(children));
  return root;
}

/** Write a text only if it changed: nothing is laid out or read aloud again for nothing. */
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
  return element;
}

/** Names in backquotes, as the terminal prints them, in the type of code. */
export const inCode = (text) => text.split("`").map((part, at) => (at % 2 ? h("code", null, part) : part));

/** Keep one element for each item of a list, by its key: focus and a held button outlive an update.
 *  `make(item)` returns an element that has `update(item)`. */
export function keyed(root, items, keyOf, make) {
  const kept = (root.kept ??= new Map());
  const next = new Map(items.map((item) => [keyOf(item), kept.get(keyOf(item)) ?? make(item)]));
  for (const [key, element] of kept) if (next.get(key) !== element) element.remove();
  let before = root.firstChild;
  for (const element of next.values()) {
    if (element === before) before = before.nextSibling;
    else root.insertBefore(element, before);
  }
  root.kept = next;
  for (const item of items) next.get(keyOf(item)).update?.(item);
}

/** A drawn sign beside words; it says nothing by itself. */
export const icon = (name) =>
  svg("svg", { class: "icon", viewBox: "0 0 24 24", "aria-hidden": "true" }, svg("path", { d: ICONS[name] }));

const ICONS = {
  live: "M3 12h4l3-8 4 16 3-8h4",
  timeline: "M3 20h18M3 16l5-6 4 4 5-9 4 5",
  setup: "M12 8.5a3.5 3.5 0 1 0 0 7 3.5 3.5 0 0 0 0-7M12 2v4M12 18v4M2 12h4M18 12h4",
  edit: "M4 20h4L19 9l-4-4L4 16zM13 7l4 4",
  recordings: "M4 5h16v14H4zM10 9v6l5-3z",
  alarms: "M6 17V11a6 6 0 0 1 12 0v6l2 2H4zM10 21h4",
  close: "M6 6l12 12M18 6L6 18",
  stop: "M8.5 3h7L21 8.5v7L15.5 21h-7L3 15.5v-7zM9 9h6v6H9z",
};

function filled(element, props, children) {
  for (const [name, value] of Object.entries(props ?? {})) set(element, name, value);
  element.append(...nodes(children));
  return element;
}

function set(element, name, value) {
  if (value === null || value === undefined || value === false) return;
  if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
  else if (name === "style") for (const [key, text] of Object.entries(value)) element.style.setProperty(key, text);
  else if (name === "dataset") Object.assign(element.dataset, value);
  else if (name === "class") element.setAttribute("class", value);
  else if (name in element && element.namespaceURI !== SVG && !name.includes("-") && name !== "list")
    element[name] = value;
  else element.setAttribute(name, value === true ? "" : value);
}

const nodes = (children) =>
  children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false && child !== "");
