// What the text in the field would have done on a recording: both runs, one above the other.

import { button, h, replace, write } from "../../dom.js";
import { words as inUnit, span } from "../../format.js";
import { TimelineChart } from "../timeline/chart.js";
import { gridded, readAt } from "../timeline/data.js";

const FOR_S = 3; // until there is something to show
const STEPS = 800;
const HOW = "The rules in the field, on what the camera saw then, beside what was decided then. Nothing moves.";
const NONE = ["There is no recording yet: make one under ", h("a", { href: "#recordings" }, "Recordings"), "."];

/** `desk` is the view: its `api`, `say`, `editor` and `unit`. */
export class Trying {
  constructor(desk) {
    this.desk = desk;
    this.recording = h("select", { "aria-label": "Recording" });
    this.button = button("What would this have done?", () => this.#try());
    this.choice = h("div", { class: "row" });
    this.told = h("div", { class: "stack", role: "status" });
    this.read = h("p", { class: "small number read" });
    const onread = (unix_s) =>
      write(this.read, unix_s === null ? "" : readAt(this.shown, unix_s, desk.unit)).textContent;
    const label = "Both runs: arrow keys read them";
    this.chart = new TimelineChart({ unit: desk.unit, label, onread });
    this.result = h("div", { class: "stack", hidden: true }, this.told, this.chart.element, this.read);
    this.element = h("section", { class: "panel stack", "aria-label": "On a recording" }, [
      h("h2", {}, "On a recording"),
      h("p", { class: "quiet" }, HOW),
      this.choice,
      this.result,
    ]);
  }

  async load() {
    try {
      const { recordings } = await this.desk.api.get("recordings");
      this.whole = recordings.filter((each) => each.seconds > 0);
      const option = ({ name, seconds }) => h("option", { value: name }, `${name} (${span(seconds)})`);
      replace(this.recording, this.whole.map(option));
      replace(this.choice, this.whole.length ? [this.recording, this.button] : h("p", {}, NONE));
    } catch (error) {
      replace(this.choice, h("p", {}, error.message));
    }
  }

  /** Each answer shows what is compared so far; a long recording takes several. */
  async #try() {
    const mine = (this.asked = Symbol("asked"));
    const text = (this.tried = this.desk.editor.text);
    const recording = this.whole.find(({ name }) => name === this.recording.value);
    this.button.disabled = true;
    this.#say("Replaying …");
    try {
      for (let progress = 0; progress < 1 && this.asked === mine; ) {
        const path = `recordings/${encodeURIComponent(recording.name)}/replay-diff`;
        const answer = await this.desk.api.post(path, { text, for_s: FOR_S });
        progress = answer.progress;
        if (this.asked === mine) this.#show(answer, recording.unix_s);
      }
    } catch (error) {
      if (this.asked !== mine) return;
      if (error.problems?.length) this.desk.show(error.problems);
      this.#say(error.message);
    } finally {
      this.button.disabled = false;
    }
  }

  /** The text in the field has changed: what another one would have done is shown no longer. */
  changed() {
    if (this.tried === undefined || this.tried === this.desk.editor.text) return;
    this.tried = undefined;
    this.stop();
    this.result.hidden = true;
  }

  /** Ask no more. */
  stop() {
    this.asked = null;
  }

  #say(words) {
    this.result.hidden = false;
    this.chart.element.hidden = true;
    replace(this.told, h("p", {}, words));
  }

  #show({ progress, to_s, words, differences, samples, thresholds_m, lanes }, began_s) {
    const item = (each) => h("li", {}, each);
    const changes = differences.map((each) => item(changed(each, this.desk.unit)));
    replace(
      this.told,
      progress < 1 && h("progress", { value: progress, "aria-label": "Replayed" }),
      h(
        "ul",
        { class: "words" },
        words.map((each) => item(inUnit(each, this.desk.unit))),
      ),
      changes.length > 0 &&
        h(
          "details",
          {},
          h("summary", {}, changes.length === 1 ? "1 event differs" : `${changes.length} events differ`),
          h("ul", { class: "list" }, changes),
        ),
    );
    const step_s = Math.max(to_s, 1) / STEPS;
    const lane = (rule, spans) => ({
      rule,
      spans: spans.map((each) => [each.from_s + began_s, each.to_s + began_s, "active"]),
    });
    this.shown = {
      times: Array.from({ length: STEPS }, (_, at) => began_s + (at + 0.5) * step_s),
      targets: Object.fromEntries(Object.entries(samples).map(([name, each]) => [name, gridded(each, STEPS, step_s)])),
      lanes: lanes.flatMap(({ rule, before, after }) => [lane(`${rule}, then`, before), lane(`${rule}, now`, after)]),
      events: [],
      clips: [],
    };
    this.chart.thresholds = thresholds_m.map((value_m) => ({ rule: "", value_m }));
    this.chart.element.hidden = this.result.hidden = false;
    this.chart.setView(began_s, began_s + to_s);
    this.chart.setData(this.shown);
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
