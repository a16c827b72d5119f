// A question before something is done: a sentence, fields to fill in, and what the answer will do.

import { Button, Field, html, render, Select, useState } from "./ui.js";

const LOST = "What you changed is lost if you leave. Leave once more to do so.";

/** Show a dialog over the page, until it is closed: `draw(leave, close)` returns what is in it. Leaving asks first where
 *  something `isChanged()`, by default where one has typed or chosen. Stop goes into it: outside of a modal dialog
 *  nothing takes a click. */
export function openDialog({ label, kind = "", isChanged = null, onclose = () => {} }, draw) {
  const asked = /** @type {HTMLElement} */ (document.activeElement);
  const stop = document.getElementById("stop");
  const dialog = document.createElement("dialog");
  const [content, warning] = ["div", "p"].map((tag) => document.createElement(tag));
  let isTouched = false;
  const mayLeave = () => {
    if (!(isChanged ? isChanged() : isTouched) || warning.textContent) return true;
    warning.textContent = LOST;
    return false;
  };
  const leave = () => mayLeave() && dialog.close();
  // Escape: as a key, since a browser closes a dialog at its second one whatever the event says.
  dialog.addEventListener("keydown", (event) => event.key === "Escape" && (event.preventDefault(), leave()));
  dialog.addEventListener("cancel", (event) => mayLeave() || event.preventDefault()); // the way back of a phone
  dialog.addEventListener("input", () => ((isTouched = true), (warning.textContent = "")));
  dialog.addEventListener("close", () => {
    ([...document.querySelectorAll("dialog:modal")].at(-1) ?? document.querySelector("header")).append(stop);
    render(null, content);
    dialog.remove();
    asked?.focus?.();
    onclose();
  });
  dialog.className = kind;
  dialog.setAttribute("aria-label", label);
  warning.className = "fault";
  warning.setAttribute("role", "alert");
  dialog.append(content, warning, stop);
  document.body.append(dialog);
  render(
    draw(leave, () => dialog.close()),
    content,
  );
  dialog.showModal();
}

/** Resolves to the values of the fields by name, or to null if it was left.
 *  A field is `{name, label, value, type, placeholder}`, or has `options: {value: label}`.
 *  With `send(values)`, which does it, it resolves to `{answer}`; where that fails, it says why, and what was typed
 *  stays. */
export function ask(question) {
  return new Promise((resolve) => {
    let given = null;
    const draw = (leave, close) =>
      html`<${Question} ...${question} leave=${leave} done=${(answer) => ((given = answer), close())} />`;
    openDialog({ label: question.title, onclose: () => resolve(given) }, draw);
  });
}

function Question({ title, words = "", fields = [], action, isDangerous = false, send = null, leave, done }) {
  const [failed, say] = useState("");
  const [isBusy, wait] = useState(false);
  const submit = async (event) => {
    event.preventDefault();
    const filled = Object.fromEntries(new FormData(event.currentTarget));
    wait(true);
    try {
      done(send ? { answer: await send(filled) } : filled);
    } catch (error) {
      say(error.message);
    }
    wait(false);
  };
  return html`<form class="stack" onsubmit=${submit}>
    <h2>${title}</h2>
    ${words && html`<p class="quiet">${words}</p>`}
    ${fields.map((each) => html`<${Field} label=${each.label}><${Control} ...${each} /><//>`)}
    <p class="fault" role="alert">${failed}</p>
    <div class="row end"><${Button} onclick=${leave}>Cancel<//>
      <button class=${`button ${isDangerous ? "danger" : "primary"}`} disabled=${isBusy}>${action}</button></div>
  </form>`;
}

const Control = ({ label, value, ...props }) =>
  props.options
    ? html`<${Select} value=${value} ...${props} />`
    : html`<input autocomplete="off" defaultValue=${value} ...${props} />`;

/** Who does something and why: both may be left empty. The name is remembered. */
export function askedBy() {
  const may = { placeholder: "may be left empty" };
  return [
    { name: "why", label: "Why", maxLength: 200, autofocus: true, ...may },
    { name: "by", label: "Your name", value: localStorage.getItem("name") ?? "", maxLength: 60, ...may },
  ];
}
