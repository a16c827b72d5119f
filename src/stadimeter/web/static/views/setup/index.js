// Set-up: one question at a time, with the picture beside it. The questions are those of `stadimeter init`.

import { api } from "../../api.js";
import { ask } from "../../dialog.js";
import { Button, html, inCode, Model, useEffect, useModel, useRef, useState } from "../../ui.js";
import { Room } from "../live/room.js";
import { Form } from "./form.js";
import { Picture } from "./picture.js";
import { Rail } from "./rail.js";
import { Save } from "./save.js";

const KINDS = {
  camera: () => import("./camera.js"),
  colour: () => import("./colour.js"),
  calibration: () => import("./calibration.js"),
  output: () => import("./output.js"),
};

/** What is asked for now, `done` when all is answered. */
const nameOf = ({ done, question }) => (done ? "done" : question.kind || question.key);

export function View(context) {
  const setup = useModel(SetUp, { context, unit: context.unit });
  const root = useRef();
  useEffect(() => void setup.open(), []);
  useEffect(() => {
    const shown = root.current?.querySelector("[data-first]") ?? root.current?.querySelector("h1");
    shown?.focus({ preventScroll: true });
    scrollTo({ top: 0 });
  }, [setup.number]);
  const { state, kind, number, places, aside, failed } = setup;
  if (failed) return html`<${Failed} ...${failed} />`;
  if (!state) return html`<p class="panel quiet">Looking for cameras, and for answers of an earlier time …</p>`;
  const hasCamera = state.answers.some(({ key }) => key === "camera");
  const [title, ...more] = state.done ? ["Save, and run it"] : state.question.text.split(/(?<=\?) /);
  return html`<div class=${`setup is-${nameOf(state)} ${hasCamera ? "" : "is-alone"}`} ref=${root}>
    <${Rail} setup=${setup} />
    <div class="setup-head"><h1 tabindex="-1">${title}</h1>
      ${more.length > 0 && html`<p class="setup-lead">${more.join(" ")}</p>`}
      <div role="status">
        <${Note} kind="is-warning" words=${state.trouble ? [state.trouble] : []} />
        <${Note} words=${state.answers.at(-1)?.notes ?? []} /></div></div>
    ${
      hasCamera &&
      html`<aside class="setup-side"><${Picture} key=${nameOf(state)} setup=${setup} draw=${kind.draw} places=${places} />
        ${state.room && html`<${Ball} room=${state.room} ...${context} />`}
        <div class="stack">${aside}</div></aside>`
    }
    <div class="setup-ask" key=${number}>
      ${state.done ? html`<${Save} setup=${setup} />` : html`<${Form} setup=${setup} kind=${kind} />`}</div>
    <p class="row small setup-end"><a href="#certificate">Certificate of the site</a>
      ${hasCamera && html`<${Button} kind="bare" onclick=${() => setup.beginAnew()}>Begin anew<//>`}</p>
  </div>`;
}

const Note = ({ kind = "", words }) =>
  words.length > 0 &&
  html`<div class=${`setup-note ${kind}`}>${words.map((each) => html`<p>${inCode(each)}</p>`)}</div>`;

/** Why there is no set-up; to try again is offered unless it would come to the same. */
function Failed({ error, again }) {
  const { message, hint } = (error.code === "demonstration" && error.problems[0]) || {};
  const words = hint ? `${capital(message)}. ${capital(hint)}.` : error.message;
  return html`<div class="panel stack"><h1>Set-up</h1>
    <p class=${hint ? "" : "setup-error"} role="alert">${inCode(words)}</p>
    <div class="row">${
      hint
        ? html`<a href="#live" class="button primary">Watch it</a>`
        : html`<${Button} kind="primary" onclick=${again}>Try again<//>`
    }</div></div>`;
}

const capital = (words) => words[0].toUpperCase() + words.slice(1);

/** The simulated room, whose ball is moved as by a hand. */
function Ball({ room, ...context }) {
  const [place, put] = useState(room);
  const send = async ({ x_m, y_m }) => put(await api.post("setup/world", { x_m, y_m }));
  const world = { targets: [{ name: "ball", ...place }], faults: {} };
  return html`<div class="setup-room"><${Room} world=${world} send=${send} ...${context} /></div>`;
}

class SetUp extends Model {
  state = null; // as the server has it
  failed = null; // why there is none: `{error, again}`
  kind = {}; // of the question: the module of its form
  number = 0; // of what is shown
  isLooking = true; // through the camera
  places = null; // that are chosen in the picture; see `Picture`
  aside = null; // what stands below the picture
  #newest = 0;
  #isBusy = false;
  #isOver = false;
  #more = {}; // what was given for blanks whose turn has not come: one before them may be in doubt

  isBack = () => document.hidden || !this.state || this.sync().catch(() => {});

  leave() {
    this.#isOver = true;
    document.removeEventListener("visibilitychange", this.isBack);
  }

  /** Begin, or go on where it was left: here, or on another device. */
  async open(anew = false) {
    document.addEventListener("visibilitychange", this.isBack);
    this.put({ failed: null, isLooking: !anew }); // what begins anew closes the camera
    try {
      const state = await api.get("setup");
      await this.show(state.begun && !anew ? state : await this.#begin(anew));
    } catch (error) {
      this.put({ failed: { error, again: () => this.open() } });
    }
  }

  async beginAnew() {
    const words = "Every question is asked again, with your answers ready. What is saved stays until you save again.";
    if (await ask({ title: "Begin the set-up anew?", words, action: "Begin anew" })) await this.open(true);
  }

  /** Answer the question, and those that follow as far as `more` has their answers by key; show the state that
   *  follows. Throws what is wrong with an answer. */
  answer(text, more = {}) {
    Object.assign(this.#more, more);
    return this.#alone(async () => {
      const asked = this.state.question.key;
      const send = (answer, question) => api.post("setup/answer", { answer, question, confirm: true });
      let state = await send(text, asked);
      try {
        while (!state.doubt && state.question?.key !== asked && state.question?.key in this.#more) {
          const { key } = state.question;
          const given = this.#more[key];
          delete this.#more[key];
          state = await send(given, key);
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
        let state = null;
        for (let each = 0; each < count; each += 1) state = await api.post("setup/back");
        await this.show(state);
      });
    } catch (error) {
      this.context.say(error.message, "error");
    }
  }

  /** One step at a time, of the question that is shown: the second press of a double click is about one that is not. */
  async #alone(step) {
    if (this.#isBusy) return;
    this.#isBusy = true;
    try {
      if (await this.sync()) await step();
    } finally {
      this.#isBusy = false;
    }
  }

  async show(state) {
    const number = ++this.#newest;
    const kind = (await KINDS[nameOf(state)]?.()) ?? {};
    if (this.#isOver || number !== this.#newest) return;
    this.put({ state, kind, number, places: null, aside: null, isLooking: true });
  }

  /** Take up what another device, or a pause, has changed; return whether the question is still the one shown. */
  async sync() {
    let state = await api.get("setup");
    if (!state.begun) state = await this.#begin(false);
    if (this.#isOver) return false;
    const isSame = state.done === this.state.done && state.question?.key === this.state.question?.key;
    if (isSame) return true;
    await this.show(state);
    this.context.say("The set-up went on meanwhile, or on another device: this is where it is now.", "warning");
    return false;
  }

  #begin(anew) {
    return api.post("setup/begin", { anew });
  }
}
