// A question before something is done: a sentence, fields to fill in, and what the answer will do.

import { h } from "./dom.js";

/** Resolves to the values of the fields by name, or null if it was left.
 *  A field is `{name, label, value, type, placeholder}`, or has `options: [[value, label], …]`. */
export function ask({ title, words = "", fields = [], action, isDangerous = false }) {
  return new Promise((resolve) => {
    const form = h(
      "form",
      { method: "dialog", class: "stack" },
      h("h2", null, title),
      words && h("p", { class: "quiet" }, words),
      fields.map(field),
      h(
        "div",
        { class: "row end" },
        h("button", { type: "button", class: "button", onclick: () => dialog.close() }, "Cancel"),
        h("button", { type: "submit", class: `button ${isDangerous ? "danger" : "primary"}`, value: "yes" }, action),
      ),
    );
    const dialog = h("dialog", { "aria-label": title }, form);
    dialog.addEventListener("close", () => {
      resolve(dialog.returnValue === "yes" ? Object.fromEntries(new FormData(form)) : null);
    });
    showModal(dialog);
  });
}

/** Show a dialog over the page, until it is closed. Stop goes into it: outside of a modal dialog nothing takes a click. */
export function showModal(dialog) {
  const asked = document.activeElement;
  const stop = document.getElementById("stop");
  dialog.addEventListener("close", () => {
    dialog.remove();
    ([...document.querySelectorAll("dialog:modal")].at(-1) ?? document.querySelector("header")).append(stop);
    asked?.focus?.();
  });
  document.body.append(dialog);
  dialog.append(stop);
  dialog.showModal();
}

function field({ name, label, options, ...props }) {
  const control = options
    ? h(
        "select",
        { name, ...props },
        options.map(([value, text]) => h("option", { value, selected: value === props.value }, text)),
      )
    : h("input", { name, autocomplete: "off", ...props });
  return h("label", { class: "field" }, h("span", null, label), control);
}
