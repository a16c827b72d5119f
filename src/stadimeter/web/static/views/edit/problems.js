// What `check` says while one types: problems at their lines, the rules in words, the tests.

import { h, inCode, replace, write } from "../../dom.js";
import { SIGNS } from "./editor.js";

const PAUSE_MS = 250; // since the last key

/** Asks the server about the newest text; an answer about an older one is dropped. */
export class Checker {
  constructor(api, onanswer, onfailure) {
    Object.assign(this, { api, onanswer, onfailure, timer: 0, asked: null });
  }

  /** Check soon: again later if more is typed. */
  soon(text) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.now(text), PAUSE_MS);
  }

  async now(text, options = {}) {
    this.stop();
    const asked = (this.asked = new AbortController());
    try {
      const answer = await this.api.post("configuration/check", { text, ...options }, { signal: asked.signal });
      if (this.asked === asked) this.onanswer(answer, options);
    } catch (error) {
      if (error.name !== "AbortError" && this.asked === asked) this.onfailure(error);
    }
  }

  stop() {
    clearTimeout(this.timer);
    this.asked?.abort();
    this.asked = null;
  }
}

/** A list of problems; each leads to its line. */
export function problemList(problems, goTo) {
  return h(
    "ul",
    { class: "problems" },
    problems.map((problem) => h("li", { class: problem.severity }, problemView(problem, goTo))),
  );
}

function problemView({ message, hint, line, column, severity, file, isElsewhere }, goTo) {
  const sign = h("span", { class: "sign", "aria-hidden": "true" }, SIGNS[severity]);
  const where = [isElsewhere && file.split("/").at(-1), line && `line ${line}`].filter(Boolean).join(", ");
  const words = [
    sign,
    h("span", { class: "sr" }, `${severity}: `),
    where && h("strong", {}, `${where}: `),
    inCode(message),
  ];
  const told =
    line && !isElsewhere
      ? h("button", { type: "button", class: "to-line", onclick: () => goTo(line, column) }, words)
      : h("p", {}, words);
  return [told, hint && h("p", { class: "hint" }, inCode(hint))];
}

const count = (number, one, many) => (number === 1 ? `1 ${one}` : `${number} ${many}`);

/** One line that sums up: read aloud when it changes. */
export function summed(problems) {
  const errors = problems.filter(({ severity }) => severity !== "warning").length;
  const warnings = problems.length - errors;
  const found = [errors && count(errors, "error", "errors"), warnings && count(warnings, "warning", "warnings")].filter(
    Boolean,
  );
  return found.length ? found.join(", ") : "No errors.";
}

/** What the text means: rules in words, and its tests. */
export class Meaning {
  constructor(ontest) {
    this.summary = h("p", { class: "summary", role: "status" });
    this.problems = h("div");
    this.words = h("ul", { class: "words" });
    this.tests = h("div");
    this.element = h(
      "aside",
      { class: "meaning" },
      h("section", { class: "panel stack" }, h("h2", {}, "Check"), this.summary, this.problems),
      h("section", { class: "panel stack" }, h("h2", {}, "In words"), this.words),
      h(
        "section",
        { class: "panel stack" },
        h("h2", {}, "Tests"),
        this.tests,
        h("button", { type: "button", class: "button", onclick: ontest }, "Run its tests"),
      ),
    );
    this.#showTests(null);
  }

  /** `isTested` says whether the tests were asked for. */
  show({ problems, words, tests }, goTo, isTested) {
    write(this.summary, summed(problems));
    replace(this.problems, problems.length ? problemList(problems, goTo) : null);
    const isWrong = problems.some(({ severity }) => severity !== "warning");
    replace(
      this.words,
      words?.length
        ? words.map((each) => h("li", {}, inCode(each)))
        : h("li", {}, isWrong ? "What the rules do is said here when there is no error." : "No rules yet."),
    );
    this.#showTests(isTested ? tests : null);
  }

  /** The check itself did not work. */
  fail(words) {
    write(this.summary, words);
    replace(this.problems);
    replace(this.words);
    this.#showTests(null);
  }

  #showTests(tests) {
    if (!tests)
      return replace(
        this.tests,
        h("p", { class: "quiet" }, "A configuration can hold tests of its own rules, under [[tests]]."),
      );
    if (!tests.length) return replace(this.tests, h("p", {}, "This configuration has no tests."));
    replace(
      this.tests,
      h(
        "ul",
        { class: "tests" },
        tests.map(({ name, ok, words }) =>
          h(
            "li",
            { class: ok ? "passed" : "failed" },
            h("strong", {}, ok ? "✓ passed: " : "✕ failed: "),
            name,
            words ? h("p", { class: "hint" }, words) : null,
          ),
        ),
      ),
    );
  }
}
