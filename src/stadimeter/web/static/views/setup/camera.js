// The camera: those that are there, with a picture of each; the one that is chosen is shown live, with its exposure.

import { api } from "../../api.js";
import { Button, html, Model, Photo, useEffect, useModel, useRef } from "../../ui.js";
import { Choices } from "./form.js";

const SETTLED_MS = 500;

export function Widget({ step }) {
  const cameras = useModel(Cameras, { step });
  useEffect(() => cameras.lookThroughAll(), []);
  useEffect(() => cameras.choose(step.answer), [step.answer]);
  const look = ({ answer }) => {
    const { blob, size, failed } = cameras.looks.get(answer) ?? {};
    return html`<span class="setup-look quiet small">
      ${blob && html`<${Photo} blob=${blob} alt=${`What ${answer} sees`} />`}
      <span class=${failed && "is-wrong"}>${failed ?? size ?? "Looking …"}</span></span>`;
  };
  const { told } = cameras;
  const lock = (exposure) => cameras.lookThrough(step.answer, { exposure });
  return html`<div class="stack"><${Choices} step=${step} draw=${look} />
    <div class="stack setup-exposure" role="status">
      ${told && [...told.remarks, ...told.settings].map((each) => html`<p class="small">${each}</p>`)}
      ${told?.has_exposure && html`<${Exposure} ...${told} lock=${lock} />`}</div>
  </div>`;
}

function Exposure({ is_locked, proposed_exposure_s, exposure_s, lock }) {
  const time = useRef();
  const now_ms = Number((1000 * (proposed_exposure_s ?? exposure_s ?? 0.01)).toPrecision(2));
  return html`<div class="field">
    <span>${is_locked ? "Exposure: locked" : "Exposure: automatic. Locked, the colours stay as they are"}</span>
    <div class="setup-size">
      <input type="text" aria-label="Exposure" ref=${time} key=${now_ms} defaultValue=${`${now_ms} ms`} />
      <${Button} onclick=${() => lock(time.current.value)}>${is_locked ? "Change it" : "Lock it"}<//></div></div>`;
}

/** Looks through cameras, one at a time. */
class Cameras extends Model {
  looks = new Map(); // what each sees, by its answer: `{blob, size}`, or `{failed}`
  told = null; // of the camera that is chosen: blur, clipping, and its exposure, which may be locked
  #turn = Promise.resolve();
  #chosen = "";
  #timer = 0;
  #isOver = false;

  leave() {
    this.#isOver = true;
    clearTimeout(this.#timer);
  }

  /** Look through each camera once, for its card. */
  lookThroughAll() {
    for (const { answer } of this.step.question.options)
      this.#inTurn(async () => {
        const look = await this.#look(answer).catch((error) => ({ failed: error.message }));
        this.put({ looks: this.looks.set(answer, look) });
      });
  }

  async #look(camera) {
    const { width_px, height_px } = await api.post("setup/camera", { camera });
    const { blob } = await api.picture("setup/picture.jpg?draw=plain&width_px=320");
    return { blob, size: `${width_px} × ${height_px} pixels` };
  }

  /** Look through the camera that is chosen, unless another one is within a moment. */
  choose(answer) {
    clearTimeout(this.#timer);
    if (answer === this.#chosen) return; // it was looked through just now
    this.#chosen = answer;
    this.put({ told: null }); // what was said of the former one
    if (answer) this.#timer = setTimeout(() => this.lookThrough(answer), SETTLED_MS);
  }

  lookThrough(answer, exposure = null) {
    const isOld = () => this.#isOver || answer !== this.#chosen;
    this.#inTurn(async () => {
      if (isOld()) return;
      try {
        const told = await api.post("setup/camera", { camera: answer, ...exposure });
        if (isOld()) return;
        if (exposure) this.step.set((this.#chosen = told.answer));
        this.put({ told });
      } catch (error) {
        if (!isOld() && (exposure || !this.looks.has(answer))) this.step.say(error.message);
      }
    });
  }

  #inTurn(work) {
    this.#turn = this.#turn.then(() => this.#isOver || work());
  }
}
