// A field for TOML with line numbers, and marks at the lines with problems. The field is the browser's own, so that
// undo, find, and the way of the Tab key stay as people know them.

import { h, replace, write } from "../../dom.js";

export const SIGNS = { error: "✕", warning: "▲" };

export class Editor {
  constructor(label, onchange) {
    this.onchange = onchange;
    this.numbers = h("pre", { class: "numbers", "aria-hidden": "true" });
    this.marks = h("div", { class: "marks", "aria-hidden": "true" });
    this.field = h("textarea", {
      wrap: "off",
      spellcheck: false,
      autocapitalize: "off",
      autocomplete: "off",
      "aria-label": label,
      oninput: () => this.#changed(),
      onscroll: () => this.#scrolled(),
    });
    this.element = h("div", { class: "editor" }, this.numbers, h("div", { class: "text" }, this.marks, this.field));
    this.problems = [];
  }

  get text() {
    return this.field.value;
  }

  /** Put another text in; undo brings the former one back. */
  set text(text) {
    if (text === this.text) return;
    this.field.focus({ preventScroll: true });
    this.field.select();
    if (!this.field.value || !document.execCommand("insertText", false, text)) this.field.value = text;
    if (this.field.value !== text) this.field.value = text;
    this.field.setSelectionRange(0, 0);
    this.field.scrollTop = 0;
    this.#changed();
  }

  get line() {
    return this.text.slice(0, this.field.selectionStart).split("\n").length;
  }

  show(problems) {
    this.problems = problems;
    replace(
      this.marks,
      problems.filter(({ line }) => line).map((problem) => markOf(problem, this.text)),
    );
    this.#number();
  }

  /** Put the cursor where a problem is, and bring it into sight. */
  goTo(line, column = 1) {
    const lines = this.text.split("\n");
    const start = lines.slice(0, line - 1).reduce((sum, each) => sum + each.length + 1, 0) + Math.max(0, column - 1);
    this.field.focus();
    this.field.setSelectionRange(start, start);
    this.field.scrollTop =
      (line - 1) * parseFloat(getComputedStyle(this.field).lineHeight) - this.field.clientHeight / 3;
  }

  #changed() {
    this.#number();
    this.onchange();
  }

  #number() {
    const worst = new Map();
    for (const { line, severity } of this.problems) if (worst.get(line) !== "error") worst.set(line, severity);
    const count = this.text.split("\n").length;
    write(
      this.numbers,
      Array.from({ length: count }, (_, at) => `${SIGNS[worst.get(at + 1)] ?? ""} ${at + 1}`).join("\n"),
    );
    this.#scrolled();
  }

  #scrolled() {
    this.numbers.scrollTop = this.field.scrollTop;
    this.marks.style.transform = `translate(${-this.field.scrollLeft}px, ${-this.field.scrollTop}px)`;
  }
}

/** A strip over the line and an underline from the column to the end of that key or value. */
function markOf({ line, column, severity }, text) {
  const rest = (text.split("\n")[line - 1] ?? "").slice(Math.max(0, (column ?? 1) - 1));
  const length = Math.max(1, rest.match(/^(?:"[^"]*"|[^,}\]"#])+/)?.[0].trimEnd().length ?? 1);
  const strip = h(
    "div",
    { class: `strip ${severity}` },
    column ? h("span", { style: { "--column": column - 1, "--length": length } }) : null,
  );
  strip.style.setProperty("--line", line - 1);
  return strip;
}
