// A question before something is done: a sentence, fields to fill in, and what the answer will do.

import { button, h, write } from "./dom.js";

const LOST = "What you changed is lost if you leave. Leave once more to do so.";

/** Resolves to the values of the fields by name, or to null if it was left.
 *  A field is `{name, label, value, type, placeholder}`, or has `options: [[value, label], …]`.
 *  With `send(values)`, which does it, it resolves to `{answer}`; where that fails, it says why, and what was typed
 *  stays. */
export function ask({ title, words = "", fields = [], action, isDangerous = false, send = null }) {
  return new Promise((resolve) => {
    let given = null;
    const failed = h("p", { class: "fault", role: "alert" });
    const go = h("button", { type: "submit", class: `button ${isDangerous ? "danger" : "primary"}` }, action);
    const values = () => Object.fromEntries(new FormData(form));
    const submit = async (event) => {
      event.preventDefault();
      const filled = values();
      go.disabled = true;
      try {
        given = send ? { answer: await send(filled) } : filled;
        dialog.close();
      } catch (error) {
        write(failed, error.message);
      }
      go.disabled = false;
    };
    const form = h(
      "form",
      { class: "stack", onsubmit: submit },
      h("h2", null, title),
      words && h("p", { class: "quiet" }, words),
      fields.map(field),
      failed,
      h(
        "div",
        { class: "row end" },
        button("Cancel", () => leave()),
        go,
      ),
    );
    const dialog = h("dialog", { "aria-label": title }, form);
    const before = JSON.stringify(values());
    dialog.addEventListener("close", () => resolve(given));
    const leave = showModal(dialog, () => JSON.stringify(values()) !== before);
  });
}

/** Who does something and why: both may be left empty. The name is remembered. */
export const askedBy = () => [
  { name: "why", label: "Why", placeholder: "may be left empty", maxLength: 200, autofocus: true },
  {
    name: "by",
    label: "Your name",
    value: localStorage.getItem("name") ?? "",
    placeholder: "may be left empty",
    maxLength: 60,
  },
];

/** Show a dialog over the page, until it is closed; returns what leaves it. Where something was changed, `isChanged()`,
 *  leaving asks first. Stop goes into it: outside of a modal dialog nothing takes a click. */
export function showModal(dialog, isChanged = () => false) {
  const asked = document.activeElement;
  const stop = document.getElementById("stop");
  const warning = h("p", { class: "fault", role: "alert" });
  const mayLeave = () => {
    if (!isChanged() || warning.isConnected) return true;
    dialog.append(write(warning, LOST));
    return false;
  };
  const leave = () => mayLeave() && dialog.close();
  // Escape: as a key, since a browser closes a dialog at its second one whatever the event says.
  dialog.addEventListener("keydown", (event) => event.key === "Escape" && (event.preventDefault(), leave()));
  dialog.addEventListener("cancel", (event) => mayLeave() || event.preventDefault()); // the way back of a phone
  dialog.addEventListener("input", () => warning.remove());
  dialog.addEventListener("close", () => {
    dialog.remove();
    ([...document.querySelectorAll("dialog:modal")].at(-1) ?? document.querySelector("header")).append(stop);
    asked?.focus?.();
  });
  document.body.append(dialog);
  dialog.append(stop);
  dialog.showModal();
  return leave;
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
