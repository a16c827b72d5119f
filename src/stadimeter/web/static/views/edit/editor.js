// A field for TOML with line numbers, and marks at the lines with problems. The field is the browser's own, so that
// undo, find, and the way of the Tab key stay as people know them.

import { html, useLayoutEffect, useRef } from "../../ui.js";

export const SIGNS = { error: "✕", warning: "▲" };

/** `text` is what the field holds, as `onchange(text)` told it; the field begins with the first one. `hand.put(text)`
 *  puts another one in, which undo takes back, and `hand.goTo(line, column)` puts the cursor where a problem is. */
export function Editor({ label, text, problems, onchange, hand }) {
  const [field, numbers, marks] = [useRef(), useRef(), useRef()];
  const first = useRef(text);
  const scrolled = () => {
    const { scrollLeft, scrollTop } = field.current;
    numbers.current.scrollTop = scrollTop;
    marks.current.style.transform = `translate(${-scrollLeft}px, ${-scrollTop}px)`;
  };
  useLayoutEffect(scrolled);

  hand.put = (other) => {
    const { current: its } = field;
    if (other === its.value) return;
    its.focus({ preventScroll: true });
    its.select();
    document.execCommand("insertText", false, other);
    if (its.value !== other) its.value = other;
    its.setSelectionRange(0, 0);
    its.scrollTop = 0;
    onchange(other);
  };
  hand.goTo = (line, column = 1) => {
    const { current: its } = field;
    const before = text.split("\n").slice(0, line - 1);
    const start = before.reduce((sum, each) => sum + each.length + 1, 0) + Math.max(0, column - 1);
    its.focus();
    its.setSelectionRange(start, start);
    its.scrollTop = (line - 1) * parseFloat(getComputedStyle(its).lineHeight) - its.clientHeight / 3;
  };

  const lines = text.split("\n");
  const worst = new Map();
  for (const { line, severity } of problems) if (worst.get(line) !== "error") worst.set(line, severity);
  const numbered = lines.map((_, at) => `${SIGNS[worst.get(at + 1)] ?? ""} ${at + 1}`).join("\n");
  return html`<div class="editor">
    <pre class="numbers" aria-hidden="true" ref=${numbers}>${numbered}</pre>
    <div class="text">
      <div class="marks" aria-hidden="true" ref=${marks}>
        ${problems.filter(({ line }) => line).map((each) => html`<${Mark} ...${each} text=${lines[each.line - 1]} />`)}
      </div>
      <textarea wrap="off" spellcheck=${false} autocapitalize="off" autocomplete="off" aria-label=${label} ref=${field}
        defaultValue=${first.current} oninput=${(event) => onchange(event.target.value)} onscroll=${scrolled} />
    </div>
  </div>`;
}

/** A strip over the line and an underline from the column to the end of that key or value. */
function Mark({ line, column, severity, text = "" }) {
  const rest = text.slice(Math.max(0, (column ?? 1) - 1));
  const length = Math.max(1, rest.match(/^(?:"[^"]*"|[^,}\]"#])+/)?.[0].trimEnd().length ?? 1);
  return html`<div class=${`strip ${severity}`} style=${{ "--line": line - 1 }}>
    ${column > 0 && html`<span style=${{ "--column": column - 1, "--length": length }} />`}</div>`;
}
