// The picture of the camera beside the questions: newest first, with what was found in it, and places to click on.

import { h, replace, svg } from "../../dom.js";
import { distance } from "../../format.js";

const PAUSE_MS = 60;
const AGAIN_MS = 1500;
const WIDTH_PX = 960;

export class Picture {
  #timer = 0;
  #stop = null;
  #mode = {};
  #url = "";
  #listeners = [];
  values = null;

  /** `recover()` is called after a picture that failed. */
  constructor({ api, unit }, recover) {
    this.recover = recover;
    this.api = api;
    this.unit = unit;
    this.image = h("img", { alt: "What the camera sees", draggable: false });
    this.marks = svg("svg", { class: "setup-marks", "aria-hidden": "true" });
    this.stage = h("div", { class: "setup-stage-picture" }, this.image, this.marks);
    this.caption = h("p", { class: "setup-caption quiet small", role: "status" });
    this.element = h("figure", { class: "setup-picture" }, this.stage, h("figcaption", null, this.caption));
  }

  /** What is drawn: `{draw, onPlace(x_px, y_px), onCross(x_px, y_px), isSaid}`, where what is found is
   *  said elsewhere; the default is the target, and no places. */
  mode(mode) {
    this.#mode = { draw: "target", ...mode };
    this.#listeners = [];
    replace(this.marks);
    this.#makeClickable(Boolean(mode.onPlace));
  }

  /** Whether a step says itself what is found. */
  get isSaid() {
    return Boolean(this.#mode.isSaid);
  }

  /** Hear of the values of each picture. */
  onValues(fn) {
    this.#listeners.push(fn);
  }

  start() {
    if (this.#stop) return;
    this.#stop = new AbortController();
    this.#next();
  }

  stop() {
    clearTimeout(this.#timer);
    this.#stop?.abort();
    this.#stop = null;
  }

  /** Show marks: `[{x_px, y_px, label, kind}]`, in the pixels of the camera. */
  mark(marks) {
    const unit = (this.values?.width_px ?? 640) / 100;
    replace(
      this.marks,
      marks.map(({ x_px, y_px, label = "", kind = "click" }) =>
        svg(
          "g",
          { class: `is-${kind}`, transform: `translate(${x_px} ${y_px}) scale(${unit})` },
          svg("path", { class: "halo", d: SHAPES[kind] }),
          svg("path", { d: SHAPES[kind] }),
          label && svg("text", { x: 2.6, y: -1.6 }, label),
        ),
      ),
    );
  }

  async #next() {
    const stop = this.#stop;
    let pause = PAUSE_MS;
    try {
      if (!document.hidden) await this.#show(stop);
    } catch (error) {
      if (stop.signal.aborted) return;
      this.#tell(error.message, true);
      pause = AGAIN_MS;
      await this.recover().catch(() => {});
    }
    if (!stop.signal.aborted) this.#timer = setTimeout(() => this.#next(), pause);
  }

  async #show(stop) {
    const { blob, values } = await this.api.picture(`setup/picture.jpg?draw=${this.#mode.draw}&width_px=${WIDTH_PX}`, {
      signal: stop.signal,
    });
    if (stop.signal.aborted) return;
    const url = URL.createObjectURL(blob);
    this.image.src = url;
    await this.image.decode().catch(() => {});
    URL.revokeObjectURL(this.#url);
    this.#url = url;
    this.values = values;
    this.marks.setAttribute("viewBox", `0 0 ${values.width_px} ${values.height_px}`);
    this.#tell(
      [this.#measured(values), this.#mode.isSaid ? "" : values.words, ...(values.remarks ?? [])]
        .filter(Boolean)
        .join(" "),
    );
    this.caption.classList.toggle("is-missing", Boolean(values.words) && !values.found);
    for (const fn of this.#listeners) fn(values);
  }

  #measured({ distance_m, sigma_m }) {
    return distance_m === null || distance_m === undefined ? "" : `${distance(distance_m, sigma_m, this.unit).text}.`;
  }

  #tell(words, isWrong = false) {
    if (this.caption.textContent !== words) replace(this.caption, words);
    this.caption.classList.toggle("is-wrong", isWrong);
  }

  #makeClickable(isIt) {
    this.stage.classList.toggle("is-clickable", isIt);
    this.stage.onpointerdown = isIt ? (event) => this.#clicked(event) : null;
    this.stage.onkeydown = isIt ? (event) => this.#keyed(event) : null;
    this.cross = null;
    for (const [name, value] of [
      ["tabindex", "0"],
      ["role", "application"],
      ["aria-label", "The picture. Arrow keys move a cross, with shift by one pixel; Enter takes the place under it."],
    ]) {
      if (isIt) this.stage.setAttribute(name, value);
      else this.stage.removeAttribute(name);
    }
  }

  #clicked(event) {
    if (event.button || !this.values) return;
    const { x: x_px, y: y_px } = new DOMPoint(event.clientX, event.clientY).matrixTransform(
      this.marks.getScreenCTM().inverse(),
    );
    if (x_px >= 0 && y_px >= 0 && x_px < this.values.width_px && y_px < this.values.height_px)
      this.#mode.onPlace(Math.floor(x_px), Math.floor(y_px));
  }

  #keyed(event) {
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!this.values || !(way || ((event.key === "Enter" || event.key === " ") && this.cross))) return;
    event.preventDefault();
    const { width_px, height_px } = this.values;
    if (!way) return void this.#mode.onPlace(...this.cross);
    const step = event.shiftKey ? 1 : Math.max(1, Math.round(width_px / 64));
    const [x_px, y_px] = this.cross ?? [Math.round(width_px / 2), Math.round(height_px / 2)];
    this.cross = [
      Math.min(width_px - 1, Math.max(0, x_px + step * way[0])),
      Math.min(height_px - 1, Math.max(0, y_px + step * way[1])),
    ];
    this.#mode.onCross?.(...this.cross);
  }
}

const SHAPES = {
  click: "M-2.2 0H2.2M0-2.2V2.2",
  cross: "M-6 0H-1M1 0H6M0-6V-1M0 1V6",
  other: "M0-3 3 0 0 3-3 0Z",
};
