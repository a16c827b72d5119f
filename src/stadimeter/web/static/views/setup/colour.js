// The colour of a ball: click on it, look at the mask, move its sliders, and click again in another light.

import { api } from "../../api.js";
import { ColourSliders } from "../../colour_sliders.js";
import { latest } from "../../latest.js";
import { Button, html, Model, useEffect, useModel } from "../../ui.js";

const MARKED_MS = 1200; // the ball may move on
const HOW =
  "Click on the ball in the picture. Click again where the light falls otherwise, and in another light: the clicks " +
  "count together.";

export const draw = "mask";

export function Widget({ step }) {
  const colour = useModel(Colour, { step });
  useEffect(() => colour.begin(), []);
  const { answer, figures } = colour;
  const {
    range = "",
    found,
    others = [],
    pictures = 0,
    words = step.question.ready ? "" : "Click on the ball.",
  } = answer;
  const isGood = found && !others.length;
  return html`<div class="stack"><p>${HOW}</p>
    <p role="status" class=${`setup-found ${isGood ? "is-good" : range ? "is-warning" : ""}`}>${words}</p>
    <div class="row small">${
      pictures > 0 &&
      html`<span class="quiet">${pictures} ${pictures === 1 ? "picture counts" : "pictures count"}.</span>`
    }</div>
    <div class="row"><${Button} onclick=${() => colour.ask({ look: true })}>Look for it<//>
      ${pictures > 0 && html`<${Button} onclick=${() => colour.forget()}>Forget the clicks<//>`}</div>
    <${ColourSliders} range=${step.answer} figures=${figures} onrange=${(chosen) => colour.choose(chosen)} /></div>`;
}

class Colour extends Model {
  answer = {}; // the newest: `{range, words, found, others, pictures}`
  figures = null; // of the newest picture
  #clicks = [];

  /** Take the picture for clicks, and try the range that is ready, or that of what stands out. */
  begin() {
    const onPlace = (x_px, y_px) => {
      this.#clicks.push({ x_px, y_px });
      this.ask({ clicks: [[x_px, y_px]], of: "newest" });
    };
    this.places = { onPlace, onValues: ({ range }) => this.put({ figures: range }) };
    this.#mark();
    const { ready } = this.step.question;
    this.ask(ready ? { range: ready } : { look: true }, true);
    return () => this.ask.end();
  }

  choose(range) {
    this.step.set(range);
    this.ask({ range });
  }

  forget() {
    this.#clicks = [];
    this.ask({ forget: true });
  }

  /** Ask one after the other; of several that wait, the newest. */
  ask = latest(async (signal, args, isQuiet = false) => {
    const { step } = this;
    step.put({ isWaiting: true });
    try {
      this.answer = await api.post("setup/colour", args);
      if (signal.aborted) return;
      if (args.range === undefined || args.range === step.answer) step.set(this.answer.range);
      if (args.clicks) setTimeout(() => ((this.#clicks = []), this.#mark()), MARKED_MS);
    } catch (error) {
      if (args.clicks) this.#clicks.pop();
      if (args.range) this.answer = { pictures: this.answer.pictures, words: "" }; // it was about the former one
      if (!isQuiet) step.say(error.message);
    }
    step.put({ isWaiting: false });
    this.#mark();
  });

  #mark() {
    const other = ({ centre_px: [x_px, y_px] }) => ({ x_px, y_px, kind: "other", label: "same colour" });
    const marks = [...this.#clicks, ...(this.answer.others ?? []).map(other)];
    this.step.setup.put({ places: { ...this.places, marks } });
  }
}
