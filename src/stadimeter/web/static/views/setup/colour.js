// The colour of a ball: click on it, look at the mask, move its sliders, and click again in another light.

import { colourSliders } from "../../colour_sliders.js";
import { button, h, replace } from "../../dom.js";

const MARKED_MS = 1200; // the ball may move on

export function widget(step) {
  const colour = new Colour(step);
  colour.begin();
  return colour.element;
}

class Colour {
  #state = { clicks: [], others: [], pictures: 0 };
  #isAsking = false;
  #waiting = null;

  constructor(step) {
    const { question } = step;
    Object.assign(this, { step, picture: step.picture });
    this.words = h("p", { role: "status", class: "setup-found" }, question.ready ? "" : "Click on the ball.");
    this.sliders = colourSliders((range) => this.#ask({ range }));
    this.again = button("Forget the clicks", () => this.#forget());
    const look = button("Look for it", () => this.#ask({ look: true }));
    this.kept = h("div", { class: "row small" });
    this.element = h(
      "div",
      { class: "stack" },
      h(
        "p",
        null,
        "Click on the ball in the picture. Click again where the light falls otherwise, and in another light: " +
          "the clicks count together.",
      ),
      this.words,
      this.kept,
      h("div", { class: "row" }, look, this.again),
      this.sliders.element,
    );
  }

  /** Take the picture for clicks, and try the range that is ready. */
  begin() {
    const { step, picture } = this;
    const { ready } = step.question;
    picture.mode({
      draw: "mask",
      isSaid: true,
      onPlace: (x_px, y_px) => this.#clicked(x_px, y_px),
      onCross: () => this.#draw(),
    });
    picture.onValues((values) => {
      this.#draw();
      this.sliders.tell(values.range);
    });
    step.text.addEventListener("change", () => this.#ask({ range: step.answer }));
    this.#ask(ready ? { range: ready } : {}, true);
    picture.stage.dataset.first = "";
    step.setup.onLeave(() => delete picture.stage.dataset.first);
    this.#tell();
  }

  #clicked(x_px, y_px) {
    this.#state.clicks.push({ x_px, y_px });
    this.#ask({ clicks: [[x_px, y_px]], of: "newest" });
  }

  #forget() {
    this.#state.clicks = [];
    this.#ask({ forget: true });
  }

  /** Ask one after the other; of several that wait, the newest. */
  async #ask(args, isQuiet = false) {
    const { step } = this;
    if (this.#isAsking) return void (this.#waiting = args);
    this.#isAsking = true;
    step.progress.hidden = false;
    try {
      this.#taken(await step.api.post("setup/colour", args), args);
    } catch (error) {
      if (args.clicks) this.#state.clicks.pop();
      if (args.range) replace(this.words); // they were about the former one
      if (!isQuiet) step.say(error.message);
    }
    this.#isAsking = false;
    step.progress.hidden = true;
    if (!this.#waiting) return;
    const next = this.#waiting;
    this.#waiting = null;
    this.#ask(next);
  }

  #taken(answer, args) {
    const { step, words } = this;
    Object.assign(this.#state, { others: answer.others, pictures: answer.pictures });
    if (answer.range || args.forget !== undefined) step.set(answer.range);
    if (!this.#waiting) this.sliders.show(answer.range);
    step.say("");
    replace(words, answer.words);
    words.classList.toggle("is-good", answer.found && !answer.others.length);
    words.classList.toggle("is-warning", Boolean(answer.range) && (!answer.found || answer.others.length > 0));
    if (args.clicks) setTimeout(() => (this.#state.clicks = []), MARKED_MS);
    this.#tell();
  }

  #tell() {
    const { pictures } = this.#state;
    this.again.hidden = !pictures;
    replace(
      this.kept,
      pictures > 0 &&
        h("span", { class: "quiet" }, `${pictures} ${pictures === 1 ? "picture counts" : "pictures count"}.`),
    );
  }

  #draw() {
    const { cross } = this.picture;
    this.picture.mark([
      ...this.#state.clicks,
      ...this.#state.others.map(({ centre_px: [x_px, y_px] }) => ({ x_px, y_px, kind: "other", label: "same colour" })),
      ...(cross ? [{ x_px: cross[0], y_px: cross[1], kind: "cross" }] : []),
    ]);
  }
}
