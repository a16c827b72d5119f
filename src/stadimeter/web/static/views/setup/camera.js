// The camera: those that are there, with a picture of each; the one that is chosen is shown live, with its exposure.

import { button, h, replace } from "../../dom.js";
import { choices } from "./form.js";

const SETTLED_MS = 500;

export function widget(step) {
  const views = new Map(); // where the picture of each goes, by its answer
  const draw = ({ answer }) => {
    views.set(answer, h("span", { class: "setup-look quiet small" }, "Looking …"));
    return views.get(answer);
  };
  const cards = choices(step, { draw });
  const camera = new Camera(step, views);
  step.setup.onLeave(() => camera.leave());
  for (const [answer, view] of views) camera.look(answer, view);
  step.onAnswer((answer) => camera.soon(answer));
  return h("div", { class: "stack" }, cards, camera.exposure);
}

/** Looks through cameras, one at a time. */
class Camera {
  #turn = Promise.resolve();
  #asked = 0; // of the camera that is chosen
  #timer = 0;
  #urls = [];
  #isOver = false;
  #isTaken = false;

  constructor(step, views) {
    Object.assign(this, {
      step,
      views,
      api: step.api,
      exposure: h("div", { class: "stack setup-exposure", role: "status" }),
    });
  }

  leave() {
    this.#isOver = true;
    clearTimeout(this.#timer);
    for (const url of this.#urls) URL.revokeObjectURL(url);
  }

  /** Look through a camera once, for its card. */
  look(answer, view) {
    this.#inTurn(async () => {
      try {
        const { width_px, height_px } = await this.api.post("setup/camera", { camera: answer });
        const { blob } = await this.api.picture("setup/picture.jpg?draw=plain&width_px=320");
        if (this.#isOver) return;
        const url = URL.createObjectURL(blob);
        this.#urls.push(url);
        replace(
          view,
          h("img", { src: url, alt: `What ${answer} sees` }),
          h("span", null, `${width_px} × ${height_px} pixels`),
        );
      } catch (error) {
        replace(view, h("span", { class: "is-wrong" }, error.message));
      }
    });
  }

  /** Look through the camera that is chosen, unless another one is within a moment. */
  soon(answer) {
    clearTimeout(this.#timer);
    if (this.#isTaken) return;
    this.#forget(); // what was said of the former one
    this.#timer = setTimeout(() => this.#chosen(answer), SETTLED_MS);
  }

  /** Say what is to be said of the camera that is chosen: blur, clipping, and its exposure, which may be locked. */
  #chosen(answer, changes = null) {
    const mine = ++this.#asked;
    const isOld = () => this.#isOver || mine !== this.#asked;
    this.#inTurn(async () => {
      if (isOld() || !answer) return;
      try {
        const told = await this.api.post("setup/camera", { camera: answer, ...changes });
        if (!isOld()) this.#tell(told, Boolean(changes));
      } catch (error) {
        if (isOld()) return;
        if (changes || !this.views.has(answer)) this.step.say(error.message);
        if (!changes) this.#forget();
      }
    });
  }

  #forget() {
    replace(this.exposure);
  }

  #inTurn(work) {
    this.#turn = this.#turn.then(() => this.#isOver || work());
  }

  #tell(told, isTaken) {
    if (isTaken && told.answer !== this.step.answer) {
      this.#isTaken = true; // it was looked through just now
      this.step.set(told.answer);
      this.#isTaken = false;
    }
    replace(
      this.exposure,
      [...told.remarks, ...told.settings].map((each) => h("p", { class: "small" }, each)),
      told.has_exposure && this.#exposure(told),
    );
  }

  #exposure({ is_locked, proposed_exposure_s, exposure_s }) {
    const now_s = proposed_exposure_s ?? exposure_s ?? 0.01;
    const time = h("input", {
      type: "text",
      value: `${Number((1000 * now_s).toPrecision(2))} ms`,
      "aria-label": "Exposure",
    });
    const lock = button(is_locked ? "Change it" : "Lock it", () =>
      this.#chosen(this.step.answer, { exposure: time.value }),
    );
    return field(
      is_locked ? "Exposure: locked" : "Exposure: automatic. Locked, the colours stay as they are",
      time,
      lock,
    );
  }
}

const field = (words, input, button) =>
  h("div", { class: "field" }, h("span", null, words), h("div", { class: "setup-size" }, input, button));
