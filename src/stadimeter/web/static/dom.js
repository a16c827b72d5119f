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
