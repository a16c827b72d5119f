// Set-up: one question at a time, with the picture beside it. The questions are those of `stadimeter init`.

import { ask } from "../../dialog.js";
import { button, h, inCode, replace } from "../../dom.js";
import { distance } from "../../format.js";
import { answerForm } from "./form.js";
import { Picture } from "./picture.js";
import { drawRail } from "./rail.js";

const STEPS = {
  camera: () => import("./camera.js"),
  colour: () => import("./colour.js"),
  calibration: () => import("./calibration.js"),
  output: () => import("./output.js"),
  done: () => import("./save.js"),
};

const capital = (words) => words[0].toUpperCase() + words.slice(1);

/** What is asked for now, `done` when all is answered. */
const kindOf = (state) => (state.done ? "done" : state.question.kind || state.question.key);

export function mount(root, context) {
  const setup = new SetUp(root, context);
  setup.open();
  return () => setup.takeDown();
}

class SetUp {
  #root;
  #undo = [];
  #drawn = 0;
  #isBusy = false;
  #more = {}; // what was given for blanks whose turn has not come: one before them may be in doubt

  constructor(root, context) {
    this.#root = root;
    this.context = context;
    this.api = context.api;
    this.picture = new Picture(context, () => this.#sync());
    const isBack = () => document.hidden || this.state === undefined || this.#sync().catch(() => {});
    document.addEventListener("visibilitychange", isBack);
    this.undoWatch = () => document.removeEventListener("visibilitychange", isBack);
  }

  /** Begin, or go on where it was left: here, or on another device. */
  async open() {
    replace(this.#root, h("p", { class: "panel quiet" }, "Looking for cameras, and for answers of an earlier time …"));
    try {
      const state = await this.api.get("setup");
      this.show(state.begun ? state : await this.#begin(false));
    } catch (error) {
      this.#say(error, () => this.open());
    }
  }

  async beginAnew() {
    const words = "Every question is asked again, with your answers ready. What is saved stays until you save again.";
    if (!(await ask({ title: "Begin the set-up anew?", words, action: "Begin anew" }))) return;
    this.picture.stop();
    try {
      this.show(await this.#begin(true));
    } catch (error) {
      this.#say(error, () => this.open());
    }
  }

  /** Answer the question, and those that follow as far as `more` has their answers by key; show the state that
   *  follows. Throws what is wrong with an answer. */
  answer(text, more = {}) {
    Object.assign(this.#more, more);
    return this.#alone(async () => {
      const asked = this.state.question.key;
      if (!(await this.#sync())) return;
      let state = await this.api.post("setup/answer", { answer: text, question: asked, confirm: true });
      try {
        while (!state.doubt && state.question?.key !== asked && state.question?.key in this.#more) {
          const { key } = state.question;
          const given = this.#more[key];
          delete this.#more[key];
          state = await this.api.post("setup/answer", { answer: given, question: key, confirm: true });
        }
      } catch (error) {
        this.context.say(error.message, "error");
      }
      await this.show(state);
    });
  }

  /** Take back the last answers, as many as are told. */
  async back(count = 1) {
    this.#more = {};
    try {
      await this.#alone(async () => {
        if (!(await this.#sync())) return;
        let state;
        for (let each = 0; each < count; each += 1) state = await this.api.post("setup/back");
        if (state) await this.show(state);
      });
    } catch (error) {
      this.context.say(error.message, "error");
    }
  }

  /** One step at a time: the second press of a double click is about a question that is not shown yet. */
  async #alone(step) {
    if (this.#isBusy) return;
    this.#isBusy = true;
    try {
      await step();
    } finally {
      this.#isBusy = false;
    }
  }

  /** Show a state: the rail, the question with what belongs to its kind, and the picture. */
  async show(state) {
    const mine = ++this.#drawn;
    const kind = kindOf(state);
    const { widget } = (await STEPS[kind]?.()) ?? {};
    if (mine !== this.#drawn) return;
    this.#cleanUp();
    this.state = state;
    this.picture.mode({});
    this.aside = h("div", { class: "stack" });
    const mover = state.room && room(this, state.room.x_m);
    const hasCamera = state.answers.some(({ key }) => key === "camera");
    const [title, ...more] = state.done ? ["Save, and run it"] : state.question.text.split(/(?<=\?) /);
    const heading = h("h1", { tabindex: -1 }, title);
    const form = kind === "done" ? widget(this) : answerForm(this, widget);
    const side = h("aside", { class: "setup-side", hidden: !hasCamera }, this.picture.element, mover, this.aside);
    replace(
      this.#root,
      h(
        "div",
        { class: `setup is-${kind}${hasCamera ? "" : " is-alone"}` },
        drawRail(this),
        h(
          "div",
          { class: "setup-head" },
          heading,
          more.length > 0 && h("p", { class: "setup-lead" }, more.join(" ")),
          this.#notes(state),
        ),
        side,
        h("div", { class: "setup-ask" }, form),
        hasCamera &&
          h(
            "p",
            { class: "setup-end" },
            button("Begin anew", () => this.beginAnew(), "bare"),
          ),
      ),
    );
    if (hasCamera) this.picture.start();
    (form.querySelector("[data-first]") ?? heading).focus({ preventScroll: true });
    scrollTo({ top: 0 });
  }

  /** What a step must end when the next one is shown. */
  onLeave(undo) {
    this.#undo.push(undo);
  }

  takeDown() {
    this.isOver = true;
    this.#drawn += 1;
    this.#cleanUp();
    this.undoWatch();
    this.picture.stop();
  }

  /** Take up what another device, or a pause, has changed; return whether the question is still the one shown. */
  async #sync() {
    let state = await this.api.get("setup");
    if (!state.begun) state = await this.#begin(false);
    if (this.isOver) return false;
    const isSame = state.done === this.state.done && state.question?.key === this.state.question?.key;
    if (!isSame) {
      await this.show(state);
      this.context.say("The set-up went on meanwhile, or on another device: this is where it is now.", "warning");
    }
    return isSame;
  }

  #begin(anew) {
    return this.api.post("setup/begin", { anew });
  }

  #notes(state) {
    const last = state.answers.at(-1)?.notes ?? [];
    const box = (kind, words) =>
      words.length > 0 &&
      h(
        "div",
        { class: `setup-note ${kind}` },
        words.map((each) => h("p", null, inCode(each))),
      );
    return h("div", { role: "status" }, box("is-warning", state.trouble ? [state.trouble] : []), box("", last));
  }

  #cleanUp() {
    for (const undo of this.#undo.splice(0)) undo();
  }

  /** Say why there is no set-up; `again` is offered unless it would come to the same. */
  #say(error, again) {
    this.picture.stop();
    const final = error.code === "demonstration" && error.problems[0];
    const words = final ? `${capital(final.message)}. ${capital(final.hint)}.` : error.message;
    const watch = h("a", { href: "#live", class: "button primary" }, "Watch it");
    const way = final ? watch : button("Try again", again, "primary");
    replace(
      this.#root,
      h(
        "div",
        { class: "panel stack" },
        h("h1", null, "Set-up"),
        h("p", { class: final ? "" : "setup-error", role: "alert" }, inCode(words)),
        h("div", { class: "row" }, way),
      ),
    );
  }
}

/** What moves the ball of the simulated room, as a hand would; it begins where the ball is. */
function room({ api, context }, x_m) {
  const inUnit = (x) => distance(x, null, { ...context.unit, decimals: 1 }).text;
  const said = h("output", null, inUnit(x_m));
  const ahead = h("input", {
    type: "range",
    min: 0.4,
    max: 6,
    step: 0.1,
    value: x_m,
    "aria-label": "Distance of the simulated ball in metres",
    oninput: () => {
      said.value = inUnit(Number(ahead.value));
      api.post("setup/world", { x_m: Number(ahead.value) }).catch((error) => context.say(error.message, "error"));
    },
  });
  return h(
    "label",
    { class: "field setup-room" },
    h("span", null, "The middle of the simulated ball is at ", said),
    ahead,
  );
}
