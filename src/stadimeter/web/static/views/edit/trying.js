// What the text in the field would have done on a recording: both runs, one above the other.

import { h, replace } from "../../dom.js";
import { span, words as inUnit } from "../../format.js";
import { lanes } from "../../lanes.js";

/** `desk` is the view: its `api`, `say`, `editor` and `unit`. */
export class Trying {
  constructor(desk) {
    this.desk = desk;
    this.recording = h("select", { "aria-label": "Recording" });
    this.button = h("button", { type: "button", class: "button", onclick: () => this.#try() }, "What would this have done?");
    this.result = h("div", { class: "stack", role: "status" });
    this.choice = h("div", { class: "row" });
    this.element = h("section", { class: "panel stack", "aria-label": "On a recording" },
      h("h2", {}, "On a recording"),
      h("p", { class: "quiet" }, "The rules in the field, on what the camera saw then, beside what was decided then. Nothing moves."), this.choice, this.result);
  }

  async load() {
    try {
      const all = await this.desk.api.get("recordings");
      const whole = (all.recordings ?? all).filter((each) => each.seconds > 0);
      replace(this.recording, whole.map(({ name, seconds }) => h("option", { value: name }, `${name} (${span(seconds)})`)));
      replace(this.choice, whole.length ? [this.recording, this.button] : h("p", {}, "There is no recording yet: make one under ", h("a", { href: "#recordings" }, "Recordings"), "."));
    } catch (error) {
      replace(this.choice, h("p", {}, error.message));
    }
  }

  async #try() {
    this.button.disabled = true;
    replace(this.result, h("p", {}, "Replaying …"));
    try {
      const name = encodeURIComponent(this.recording.value);
      this.#show(await this.desk.api.post(`recordings/${name}/replay-diff`, { text: this.desk.editor.text }));
    } catch (error) {
      if (error.problems?.length) this.desk.show(error.problems);
      replace(this.result, h("p", { class: "is-wrong" }, error.message));
    } finally {
      this.button.disabled = false;
    }
  }

  #show(answer) {
    const { unit } = this.desk;
    replace(this.result, lanes(seen(answer), unit),
      h("p", { class: "legend" }, h("span", { class: "key run-1" }), "then", h("span", { class: "key run-2" }), "with this text"),
      h("ul", { class: "list" }, [answer.words ?? []].flat().map((each) => h("li", {}, inUnit(each, unit)))));
  }
}

function seen({ from_s, to_s, samples, thresholds_m = [], lanes: rules }) {
  const runs = ({ before, after }) => [{ name: "then", spans: before }, { name: "now", spans: after }];
  return { from_s, to_s, samples, thresholds_m, lanes: rules.map((each) => ({ name: each.rule, runs: runs(each) })) };
}
