// One recording, moment by moment: its picture, what was measured, and what the rules made of it.

import { h, replace, write } from "../dom.js";
import * as format from "../format.js";

const STEP_S = 0.1;

export class Replay {
  constructor({ name, seconds }, { api, unit }, onend, at_s = 0) {
    Object.assign(this, {
      name,
      seconds,
      api,
      unit,
      onend,
      wanted: 0,
      isBusy: false,
      isPlaying: false,
      isClosed: false,
      url: "",
    });
    this.picture = h("img", { alt: "The camera's picture at that moment" });
    this.slider = h("input", {
      type: "range",
      min: 0,
      max: seconds,
      step: STEP_S,
      value: 0,
      "aria-label": "Moment of the recording",
      oninput: () => this.#moved(),
    });
    this.time = h("output");
    this.play = h("button", { type: "button", class: "button", onclick: () => this.#toggle() }, "Play");
    this.values = h("div", { class: "stack" });
    this.element = h(
      "section",
      { class: "panel stack", "aria-label": `Replay of ${name}` },
      h(
        "div",
        { class: "row" },
        h("h2", { class: "grow" }, name),
        h("button", { type: "button", class: "button", onclick: () => this.end() }, "Close"),
      ),
      h(
        "div",
        { class: "replay" },
        h(
          "div",
          { class: "stack" },
          h("figure", {}, this.picture),
          this.slider,
          h("div", { class: "row" }, this.play, this.time),
        ),
        this.values,
      ),
    );
    this.show(at_s);
  }

  /** Show a moment; while one is on its way, only the newest wish is kept. */
  async show(at_s) {
    this.wanted = Math.min(this.seconds, Math.max(0, at_s));
    this.slider.value = this.wanted;
    this.slider.setAttribute("aria-valuetext", `${this.wanted.toFixed(1)} of ${this.seconds.toFixed(1)} seconds`);
    write(this.time, `${this.wanted.toFixed(1)} s of ${this.seconds.toFixed(1)} s`);
    if (this.isBusy) return;
    this.isBusy = true;
    for (let shown = null; shown !== this.wanted && !this.isClosed; ) {
      shown = this.wanted;
      await this.#load(shown);
    }
    this.isBusy = false;
  }

  end() {
    this.close();
    this.onend();
  }

  close() {
    this.isClosed = true;
    this.isPlaying = false;
    URL.revokeObjectURL(this.url);
  }

  #moved() {
    if (this.isPlaying) this.#toggle();
    this.show(Number(this.slider.value));
  }

  async #load(at_s) {
    try {
      const { blob, values } = await this.api.picture(
        `recordings/${encodeURIComponent(this.name)}/frame.jpg?at_s=${at_s}`,
      );
      if (this.isClosed) return;
      URL.revokeObjectURL(this.url);
      this.url = blob.size ? URL.createObjectURL(blob) : "";
      this.picture.hidden = !blob.size;
      if (blob.size) this.picture.src = this.url;
      replace(this.values, describe(values, this.unit));
    } catch (error) {
      replace(this.values, h("p", {}, error.message));
      this.isPlaying = false;
    }
  }

  /** Play at the pace of the clock, as many pictures as come. */
  async #toggle() {
    this.isPlaying = !this.isPlaying;
    write(this.play, this.isPlaying ? "Pause" : "Play");
    if (!this.isPlaying) return;
    const from_s = this.wanted >= this.seconds ? 0 : this.wanted;
    const began_ms = performance.now();
    while (this.isPlaying && !this.isClosed) {
      await this.show(from_s + (performance.now() - began_ms) / 1000);
      if (this.wanted >= this.seconds) this.isPlaying = false;
      await new Promise(requestAnimationFrame);
    }
    write(this.play, "Play");
  }
}

/** What was at a moment, as `recordings/NAME/frame.jpg` and `timeline/moment` tell it. */
export function describe(
  { unix_s, targets, rules, outputs = [], events = [], safety = { mode: "active" } },
  unit,
  measured = "Measured",
) {
  const row = (name, value, why = "") =>
    h("li", {}, h("strong", {}, name), ` ${value}`, why && h("p", { class: "quiet" }, format.words(why, unit)));
  const part = (title, rows) =>
    rows.length > 0 && h("section", {}, h("h3", {}, title), h("ul", { class: "list" }, rows));
  return [
    h("p", { class: "quiet" }, format.moment(unix_s)),
    safety.mode !== "active" &&
      h("p", { class: "damaged" }, `Outputs were at their safe values: ${safety.reason || safety.mode}`),
    part(
      measured,
      targets.map((each) =>
        row(
          each.name,
          each.is_valid ? format.distance(each.distance_m, each.sigma_m, unit).text : each.status,
          each.reason,
        ),
      ),
    ),
    part(
      "Rules",
      rules.map((each) => row(each.rule, each.status, each.reason)),
    ),
    part(
      "Outputs",
      outputs.map((each) => row(each.output, driven(each, unit), each.reason)),
    ),
    part(
      "Events",
      events.map((each) =>
        row(format.moment(each.unix_s), `${each.source} ${each.kind.replaceAll("_", " ")}`, each.reason),
      ),
    ),
  ];
}

function driven({ kind, level, linear_mps, angular_radps }, unit) {
  if (kind === "motion")
    return `${format.speed(linear_mps ?? 0, unit)}, turning ${Math.round(((angular_radps ?? 0) * 180) / Math.PI)}°/s`;
  return format.level(level ?? 0);
}
