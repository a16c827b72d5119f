// An alarm that fired wrongly, mended on its chart: drag its threshold, or mark what it should have done; then save it.

import { api } from "../../api.js";
import { latest } from "../../latest.js";
import { Button, html, Model, Select, useRef } from "../../ui.js";
import { Saved } from "../edit/saving.js";

const NEAR_PX = 8; // a pointer this near to a threshold drags it
const QUIET_MS = 120;
const FOR_S = 2; // until there is something to show
const HOW =
  "Drag a threshold on the chart, or click a moment and say whether the rule should have fired. " +
  "The upper bars in its lane are what it would have done on the recordings.";

/** The buttons of a moment; what is told of it knows its place in a recording by the run's clock. */
export const Judge = ({ moment, teaching }) => html`<div class="row">
  <${Button} onclick=${() => teaching.mark(moment, true)}>Should have fired<//>
  <${Button} onclick=${() => teaching.mark(moment, false)}>Should not have fired<//></div>`;

export function WhatIf({ teaching }) {
  const { rules, rule, marks, words, settings, saved, view } = teaching;
  if (!rules.length) return null;
  const names = Object.fromEntries(rules.map((each) => [each, each]));
  const anew = () => teaching.use(rule);
  return html`<section class="panel stack of-run" aria-label="What if">
    <div class="row"><h2 class="grow">What if</h2>
      <${Select} aria-label="Rule" options=${names} value=${rule} choose=${(each) => teaching.use(each)} />
      <${Button} onclick=${anew}>Try other settings<//></div>
    <p class="quiet">${HOW}</p>
    <div class="row">
      ${Object.keys(settings).map((key) => html`<${Setting} key=${`${rule} ${key}`} name=${key} teaching=${teaching} />`)}</div>
    <p role="status">${words}</p>
    <ul class="list">${marks.map((mark) => html`<${Mark} mark=${mark} teaching=${teaching} />`)}</ul>
    <div class="row">
      <${Button} kind="primary" disabled=${!teaching.canSave} onclick=${() => teaching.save()}>Save with its test<//>
      <${Button} onclick=${anew}>Undo<//></div>
    <div role="status">
      ${saved && html`<${Saved} key=${saved.version} ...${saved} say=${view.say} />`}</div>
  </section>`;
}

function Mark({ mark, teaching }) {
  const words = `${mark.fire ? "✓ should" : "✗ should not"} have fired`;
  return html`<li class="row"><span class="grow">${words}: ${new Date(mark.unix_s * 1000).toLocaleTimeString()}</span>
    <${Button} onclick=${() => teaching.takeBack(mark)}>Take back<//></li>`;
}

/** A setting of the rule by a slider and a number; one that a person types in keeps what is typed. */
function Setting({ name, teaching }) {
  const number = useRef();
  const { value, unit } = teaching.settings[name];
  const { size_m, symbol } = unit === "m" ? teaching.view.unit : { size_m: 1, symbol: unit };
  const now = Number(((teaching.changes[name] ?? value) / size_m).toFixed(3));
  const most = Math.max(2 * value, unit === "s" ? 10 : 1, now * size_m) / size_m;
  const put = ({ target }) => teaching.set(name, Number(target.value) * size_m);
  const shown = number.current === document.activeElement ? number.current?.value : now;
  return html`<label class="stack small">${name.replaceAll("_", " ")} ${symbol && `(${symbol})`}
    <input type="range" min="0" max=${most} step=${most / 200} aria-label=${`${name}, slider`} value=${now}
      oninput=${put} />
    <input type="number" min="0" step="any" aria-label=${name} value=${shown} onchange=${put} ref=${number} /></label>`;
}

/** `view` is the timeline: its `unit`, `say`, `chart`, and `loadMarks()` for thresholds anew. */
export class Teaching extends Model {
  rules = [];
  rule = "";
  words = "";
  settings = {}; // of the rule: `{value, unit}` by name
  changes = {}; // of settings
  marks = []; // `{unix_s, fire, text}`
  saved = null;
  canSave = false;
  #thresholds = [];
  #recordings = []; // that the last answer knows
  #held = null; // the threshold that is dragged

  constructor(given) {
    super(given);
    const { view } = given;
    for (const kind of ["pointerdown", "pointermove", "pointerup", "pointercancel"])
      view.chart.element.addEventListener(kind, (event) => this.#drag(event), { capture: true });
    view.chart.overlays.add((pen) => this.#draw(pen));
  }

  put(changed) {
    super.put(changed);
    this.view.chart.redraw();
  }

  leave() {
    clearTimeout(this.quiet);
    this.#ask.end();
  }

  /** Take in the thresholds of the rules. */
  know(thresholds) {
    this.#thresholds = thresholds.filter(({ key }) => !["ramp", "follow"].includes(key));
    const rules = [...new Set(this.#thresholds.map(({ rule }) => rule))];
    this.put({ rules, rule: rules.includes(this.rule) ? this.rule : (rules[0] ?? "") });
  }

  /** Begin anew with a rule. */
  use(rule) {
    if (rule !== this.rule) this.settings = {};
    this.put({ rule, changes: {}, marks: [] });
    return this.#try();
  }

  /** @param {Record<string, any>} moment @param {boolean} fire */
  async mark({ unix_s, told: { held_by, since_s } = {} }, fire) {
    if (!this.rule) await this.view.loadMarks();
    if (!this.rule) return this.view.say("None of the rules is an alarm on a distance.", "error");
    if (!this.#at(unix_s)) await this.#try(unix_s);
    const held = this.#recordings.find(({ name }) => name === held_by);
    const found = held ?? this.#at(unix_s);
    if (!found) return this.view.say("No recording holds this moment, so nothing can be tried on it.", "error");
    const at_s = held ? since_s : unix_s - found.began_unix_s;
    const text = `${found.name}@${at_s.toFixed(3)}s ${fire ? "fire" : "no"}`;
    this.put({ marks: [...this.marks, { unix_s, fire, text }] });
    await this.#ask({ marks: this.#texts() });
  }

  takeBack(mark) {
    this.put({ marks: this.marks.filter((each) => each !== mark) });
    return this.marks.length ? this.#ask({ marks: this.#texts() }) : this.use(this.rule);
  }

  set(key, value) {
    this.#ask.end(); // an answer about the former value would put that back
    this.put({ changes: { ...this.changes, [key]: value }, canSave: false });
    clearTimeout(this.quiet);
    this.quiet = setTimeout(() => this.#try(), QUIET_MS);
  }

  #texts = () => this.marks.map(({ text }) => text);
  #moments = () => this.marks.map(({ unix_s }) => unix_s);
  #at = (unix_s) =>
    this.#recordings.find(
      ({ began_unix_s, from_s, to_s }) => began_unix_s + from_s <= unix_s && unix_s <= began_unix_s + to_s,
    );

  /** @param {"tune" | "settings"} op @returns {Promise<any>} */
  #post = (op, body, options) =>
    api.post(`rules/${encodeURIComponent(this.rule)}/${op}`, { at_s: this.#moments(), ...body }, options);

  /** Ask what would have been. */
  #try = (...unix_s) => this.#ask({ changes: this.changes, at_s: [...this.#moments(), ...unix_s], for_s: FOR_S });

  /** Ask until all recordings are read. An answer that is not wanted any more is dropped. */
  #ask = latest(
    async (signal, body) => {
      this.put({ canSave: false, words: this.#recordings.length ? this.words : "Reading the recordings …" });
      try {
        for (let isDone = false; !isDone && !signal.aborted; ) {
          const { recordings, is_done, words, ...found } = await this.#post("tune", body, { signal });
          this.#recordings = recordings;
          this.#take(found, words);
          isDone = is_done !== false || !body.for_s;
        }
      } catch (error) {
        if (!signal.aborted) this.put({ words: error.message });
      }
    },
    { calls_off: true },
  );

  #take({ changes, settings, version }, words) {
    const changed = Object.entries(changes).map(
      ([key, value]) => `${key.replaceAll("_", " ")} ${Number(value.toPrecision(4))} ${settings[key].unit}`,
    );
    const canSave = changed.length > 0 || this.marks.length > 0;
    this.version = version;
    this.put({ changes, settings, canSave, words: `${changed.length ? `With ${changed.join(", ")}: ` : ""}${words}` });
  }

  async save() {
    try {
      const body = { changes: this.changes, marks: this.#texts(), base_version: this.version };
      const saved = await this.#post("settings", body);
      const count = saved.tests.length;
      const words = count ? `with ${count} ${count === 1 ? "test that passes" : "tests that pass"}` : "without a test";
      this.put({ words: `Saved, ${words}.`, changes: {}, marks: [], canSave: false, saved });
      this.view.loadMarks();
    } catch (error) {
      this.view.say(error.message, "error");
    }
  }

  /** A pointer on a threshold moves it; the chart does not get what this takes. */
  #drag(event) {
    const { chart } = this.view;
    if (event.type === "pointerdown" && event.target === chart.area) {
      const m_per_px = chart.metresAt(0) - chart.metresAt(1);
      const apart_px = ({ value_m }) => Math.abs(chart.metresAt(event.clientY) - value_m) / m_per_px;
      const near = this.#thresholds.map(this.#dragged).filter((each) => apart_px(each) < NEAR_PX);
      const [found] = near.sort((one, two) => apart_px(one) - apart_px(two));
      if (!found) return;
      if (found.rule !== this.rule) this.use(found.rule);
      this.#held = found.key;
      chart.area.setPointerCapture(event.pointerId);
    } else if (!this.#held) return;
    else if (event.type === "pointermove")
      this.set(this.#held, Math.max(0.001, Number(chart.metresAt(event.clientY).toPrecision(3))));
    else this.#held = null;
    event.preventDefault();
  }

  #dragged = (each) =>
    each.rule === this.rule && this.changes[each.key] ? { ...each, value_m: this.changes[each.key] } : each;

  #draw({ ink, x, y, laneOf, lane, colour }) {
    const top = laneOf(this.rule);
    if (!top) return;
    ink.fillStyle = colour("accent");
    const bar = (from_s, to_s, up, height) =>
      ink.fillRect(x(from_s), top - up, Math.max(2, x(to_s) - x(from_s)), height);
    for (const { began_unix_s, from_s, to_s, after } of this.#recordings) {
      bar(began_unix_s + from_s, began_unix_s + to_s, lane / 8, lane / 12);
      for (const [begin_s, end_s] of after) bar(began_unix_s + begin_s, began_unix_s + end_s, lane / 2, lane / 2);
    }
    const ours = this.#thresholds.filter(({ rule, key }) => rule === this.rule && this.changes[key]);
    for (const { value_m } of ours.map(this.#dragged)) ink.fillRect(0, y(value_m), ink.canvas.width, 2);
    ink.textAlign = "left";
    for (const { unix_s, fire } of this.marks) ink.fillText(fire ? "✓" : "✗", x(unix_s) + lane / 3, top - lane);
  }
}
