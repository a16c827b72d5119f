// What the text in the field would have done on a recording: both runs, one above the other.

import { button, h, replace } from "../../dom.js";
import { words as inUnit, span } from "../../format.js";
import { lanes } from "../../lanes.js";

const FOR_S = 3; // until there is something to show

/** `desk` is the view: its `api`, `say`, `editor` and `unit`. */
export class Trying {
  constructor(desk) {
    this.desk = desk;
    this.recording = h("select", { "aria-label": "Recording" });
    this.button = button("What would this have done?", () => this.#try());
    this.result = h("div", { class: "stack", role: "status" });
    this.choice = h("div", { class: "row" });
    this.element = h(
      "section",
      { class: "panel stack", "aria-label": "On a recording" },
      h("h2", {}, "On a recording"),
      h(
        "p",
        { class: "quiet" },
        "The rules in the field, on what the camera saw then, beside what was decided then. Nothing moves.",
      ),
      this.choice,
      this.result,
    );
  }

  async load() {
    try {
      const all = await this.desk.api.get("recordings");
      const whole = (all.recordings ?? all).filter((each) => each.seconds > 0);
      replace(
        this.recording,
        whole.map(({ name, seconds }) => h("option", { value: name }, `${name} (${span(seconds)})`)),
      );
      replace(
        this.choice,
        whole.length
          ? [this.recording, this.button]
          : h(
              "p",
              {},
              "There is no recording yet: make one under ",
              h("a", { href: "#recordings" }, "Recordings"),
              ".",
            ),
      );
    } catch (error) {
      replace(this.choice, h("p", {}, error.message));
    }
  }

  /** Each answer shows what is compared so far; a long recording takes several. */
  async #try() {
    const mine = (this.asked = Symbol("asked"));
    const text = (this.tried = this.desk.editor.text);
    const path = `recordings/${encodeURIComponent(this.recording.value)}/replay-diff`;
    this.button.disabled = true;
    replace(this.result, h("p", {}, "Replaying …"));
    try {
      for (let progress = 0; progress < 1 && this.asked === mine; ) {
        const answer = await this.desk.api.post(path, { text, for_s: FOR_S });
        progress = answer.progress;
        if (this.asked === mine) this.#show(answer);
      }
    } catch (error) {
      if (this.asked !== mine) return;
      if (error.problems?.length) this.desk.show(error.problems);
      replace(this.result, h("p", {}, error.message));
    } finally {
      this.button.disabled = false;
    }
  }

  /** The text in the field has changed: what another one would have done is shown no longer. */
  changed() {
    if (this.tried === undefined || this.tried === this.desk.editor.text) return;
    this.tried = undefined;
    this.stop();
    replace(this.result);
  }

  /** Ask no more. */
  stop() {
    this.asked = null;
  }

  #show(answer) {
    const { unit } = this.desk;
    const changes = answer.differences.map((each) => h("li", {}, changed(each, unit)));
    replace(
      this.result,
      answer.progress < 1 && h("progress", { value: answer.progress, "aria-label": "Replayed" }),
      h(
        "ul",
        { class: "words" },
        answer.words.map((each) => h("li", {}, inUnit(each, unit))),
      ),
      lanes(seen(answer), unit),
      h(
        "p",
        { class: "row small" },
        h("span", { class: "key run-1" }),
        "then: as it was recorded",
        h("span", { class: "key run-2" }),
        "now: with the text in the field",
      ),
      changes.length > 0 &&
        h(
          "details",
          {},
          h("summary", {}, changes.length === 1 ? "1 event differs" : `${changes.length} events differ`),
          h("ul", { class: "list" }, changes),
        ),
    );
  }
}

const SIGNS = { added: "now, not then", lost: "then, not now" };

function changed({ change, by_s, at_s, kind, source, reason }, unit) {
  const how = SIGNS[change] ?? `moved by ${by_s > 0 ? "+" : ""}${by_s.toFixed(2)} s`;
  return [
    h("strong", {}, `${at_s.toFixed(2)} s, ${source}: ${kind.replaceAll("_", " ")}, ${how}. `),
    inUnit(reason, unit),
  ];
}

function seen({ from_s, to_s, samples, thresholds_m = [], lanes: rules }) {
  const runs = ({ before, after }) => [
    { name: "then", spans: before },
    { name: "now", spans: after },
  ];
  return { from_s, to_s, samples, thresholds_m, lanes: rules.map((each) => ({ name: each.rule, runs: runs(each) })) };
}
