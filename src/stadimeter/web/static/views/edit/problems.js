// What `check` says while one types: problems at their lines, the rules in words, the tests.

import { Button, html, inCode } from "../../ui.js";
import { SIGNS } from "./editor.js";

/** A list of problems; each leads to its line. */
const Problems = ({ problems, goTo }) => html`<ul class="problems">
  ${problems.map((problem) => html`<li class=${problem.severity}><${Problem} ...${problem} goTo=${goTo} /></li>`)}
</ul>`;

function Problem({ message, hint, line, column, severity, file, isElsewhere, goTo }) {
  const where = [isElsewhere && file.split("/").at(-1), line && `line ${line}`].filter(Boolean).join(", ");
  const words = html`<span class="sign" aria-hidden="true">${SIGNS[severity]}</span>
    <span class="sr">${severity}:${" "}</span>${where && html`<strong>${where}:${" "}</strong>`}${inCode(message)}`;
  const toLine = html`<button type="button" class="to-line" onclick=${() => goTo(line, column)}>${words}</button>`;
  return html`${line && !isElsewhere ? toLine : html`<p>${words}</p>`}
    ${hint && html`<p class="hint">${inCode(hint)}</p>`}`;
}

const count = (number, one, many) => (number === 1 ? `1 ${one}` : `${number} ${many}`);
const isError = ({ severity }) => severity !== "warning";

/** One line that sums up. */
function summed(problems) {
  const errors = problems.filter(isError).length;
  const warnings = problems.length - errors;
  const found = [errors && count(errors, "error", "errors"), warnings && count(warnings, "warning", "warnings")];
  return found.filter(Boolean).join(", ") || "No errors.";
}

/** What the text means: rules in words, and its tests. `answer` is that of `check`, or `{failed}` where none came. */
export function Meaning({ answer, goTo, test }) {
  const { problems = [], words = [], tests = null, failed = "" } = answer ?? {};
  const instead = problems.some(isError) ? "What the rules do is said here when there is no error." : "No rules yet.";
  const said = words.length || !answer || failed ? words : [instead];
  return html`<aside class="meaning">
    <section class="panel stack"><h2>Check</h2>
      <p class="summary" role="status">${failed || (answer && summed(problems))}</p>
      ${problems.length > 0 && html`<${Problems} problems=${problems} goTo=${goTo} />`}</section>
    <section class="panel stack"><h2>In words</h2>
      <ul class="words">${said.map((each) => html`<li>${inCode(each)}</li>`)}</ul></section>
    <section class="panel stack"><h2>Tests</h2><${Tests} tests=${tests} />
      <${Button} onclick=${test}>Run its tests<//></section>
  </aside>`;
}

function Tests({ tests }) {
  if (!tests) return html`<p class="quiet">A configuration can hold tests of its own rules, under [[tests]].</p>`;
  if (!tests.length) return html`<p>This configuration has no tests.</p>`;
  return html`<ul class="tests">${tests.map(
    ({ name, ok, words }) => html`<li class=${ok ? "passed" : "failed"}>
      <strong>${ok ? "✓ passed: " : "✕ failed: "}</strong>${name}${words && html`<p class="hint">${words}</p>`}</li>`,
  )}</ul>`;
}
