// An alarm that fired wrongly, mended on its chart: drag its threshold, or mark what it should have done; then save it.

import { button, h, replace, write } from "../../dom.js";
import { Saving } from "../edit/saving.js";

const NEAR_PX = 8; // a pointer this near to a threshold drags it
const QUIET_MS = 120;
const FOR_S = 2; // until there is something to show
const HOW =
  "Drag a threshold on the chart, or click a moment and say whether the rule should have fired. " +
  "The upper bars in its lane are what it would have done on the recordings.";
const row = (...children) => h("div", { class: "row" }, children);

/** `view` is the timeline: its `api`, `unit`, `say` and `chart`. */
export class Teaching {
  #known = []; // recordings, as the last answer has them
  #wish = 0;

  constructor(view) {
    Object.assign(this, { view, thresholds: [], rule: "", changes: {}, marks: [] });
    this.saving = new Saving(view);
    this.choice = h("select", { "aria-label": "Rule", onchange: () => this.use(this.choice.value) });
    this.fields = row();
    this.words = h("p", { role: "status" });
    this.list = h("ul", { class: "list" });
    this.keep = button("Save with its test", () => this.#save(), "primary", { disabled: true });
    const undo = () => this.use(this.rule);
    this.element = h("section", { class: "panel stack of-run", "aria-label": "What if", hidden: true });
    replace(
      this.element,
      row(h("h2", { class: "grow" }, "What if"), this.choice, button("Try other settings", undo)),
      h("p", { class: "quiet" }, HOW),
      [this.fields, this.words, this.list, row(this.keep, button("Undo", undo)), this.saving.element],
    );
    for (const kind of ["pointerdown", "pointermove", "pointerup", "pointercancel"]) {
      view.chart.element.addEventListener(kind, (event) => this.#drag(event), { capture: true });
    }
    view.chart.overlays.add((pen) => this.#draw(pen));
  }

  /** Take in the thresholds of the rules. */
  know(thresholds) {
    this.thresholds = thresholds.filter(({ key }) => !["ramp", "follow"].includes(key));
    const rules = [...new Set(this.thresholds.map(({ rule }) => rule))];
    this.element.hidden = !rules.length;
    if (rules.join() === this.rules?.join()) return;
    this.rules = rules;
    const options = rules.map((rule) => h("option", { value: rule }, rule));
    replace(this.choice, options);
    if (!rules.includes(this.rule)) this.rule = rules[0];
  }

  async #hasRule() {
    if (!this.rule) await this.view.loadMarks();
    if (!this.rule) this.view.say("None of the rules is an alarm on a distance.", "error");
    return Boolean(this.rule);
  }

  /** Begin anew with a rule. */
  use(rule) {
    Object.assign(this, { rule, changes: {}, marks: [] });
    this.choice.value = rule;
    this.#showMarks();
    return this.#ask();
  }

  /** The buttons below a moment; `told` is the answer about it, which knows its place in a recording by the run's clock. */
  buttons(unix_s, told = {}) {
    const [yes, no] = [true, false].map((fire) => () => this.#mark(unix_s, fire, told));
    return row(button("Should have fired", yes), button("Should not have fired", no));
  }

  async #mark(unix_s, fire, { held_by, since_s }) {
    if (!(await this.#hasRule())) return;
    if (!this.#at(unix_s)) await this.#ask(unix_s);
    const held = this.#known.find(({ name }) => name === held_by);
    const found = held ?? this.#at(unix_s);
    if (!found) return this.view.say("No recording holds this moment, so nothing can be tried on it.", "error");
    const at_s = held ? since_s : unix_s - found.began_unix_s;
    const text = `${found.name}@${at_s.toFixed(3)}s ${fire ? "fire" : "no"}`;
    this.marks.push({ unix_s, fire, text });
    this.#showMarks();
    await this.#answer({ marks: this.#texts() });
  }

  #texts = () => this.marks.map(({ text }) => text);
  #moments = () => this.marks.map(({ unix_s }) => unix_s);
  #at = (unix_s) =>
    this.#known.find((each) => each.began_unix_s + each.from_s <= unix_s && unix_s <= each.began_unix_s + each.to_s);

  #showMarks() {
    const takeBack = (mark) => {
      this.marks = this.marks.filter((each) => each !== mark);
      this.#showMarks();
      return this.marks.length ? this.#answer({ marks: this.#texts() }) : this.use(this.rule);
    };
    const item = (mark) => {
      const should = mark.fire ? "✓ should" : "✗ should not";
      const words = `${should} have fired: ${new Date(mark.unix_s * 1000).toLocaleTimeString()}`;
      return h(
        "li",
        { class: "row" },
        h("span", { class: "grow" }, words),
        button("Take back", () => takeBack(mark)),
      );
    };
    replace(this.list, this.marks.map(item));
  }

  /** Fields of the rule's settings; that which a person is in keeps what is typed. */
  #showFields() {
    if (this.shown !== this.rule) replace(this.fields, Object.keys(this.settings).map(this.#field));
    this.shown = this.rule;
    for (const input of this.fields.querySelectorAll("input")) {
      const { size } = this.#scale(input.name);
      const now = Number(((this.changes[input.name] ?? this.settings[input.name].value) / size).toFixed(3));
      if (input.type === "range") input.max = Math.max(input.max, now);
      if (input !== document.activeElement) input.value = now;
    }
  }

  #scale(key) {
    const { value, unit } = this.settings[key];
    const { size_m, symbol } = this.view.unit;
    const size = unit === "m" ? size_m : 1;
    return { size, symbol: unit === "m" ? symbol : unit, most: Math.max(2 * value, unit === "s" ? 10 : 1) / size };
  }

  #field = (key) => {
    const { size, symbol, most } = this.#scale(key);
    const input = (given) => h("input", { name: key, min: 0, ...given });
    const put = ({ target }) => this.#set(key, Number(target.value) * size);
    const slider = { type: "range", max: most, step: most / 200, "aria-label": `${key}, slider`, oninput: put };
    const number = { type: "number", step: "any", "aria-label": key, onchange: put };
    const words = `${key.replaceAll("_", " ")} ${symbol && `(${symbol})`}`;
    return h("label", { class: "stack small" }, words, input(slider), input(number));
  };

  #set(key, value) {
    this.changes[key] = value;
    if (this.shown === this.rule) this.#showFields();
    this.view.chart.redraw();
    clearTimeout(this.quiet);
    this.quiet = setTimeout(() => this.#ask(), QUIET_MS);
  }

  /** Ask what would have been, until all recordings are read. An answer that is not wanted any more is dropped. */
  async #ask(unix_s) {
    const at_s = unix_s ? [...this.#moments(), unix_s] : this.#moments();
    while (await this.#answer({ changes: this.changes, at_s, for_s: FOR_S }));
  }

  #post = (op, body) =>
    this.view.api.post(`rules/${encodeURIComponent(this.rule)}/${op}`, { at_s: this.#moments(), ...body });

  async #answer(body) {
    const mine = ++this.#wish;
    this.keep.disabled = true; // until there is something that its marks agree with
    write(this.words, this.#known.length ? this.words.textContent : "Reading the recordings …");
    try {
      const found = await this.#post("tune", body);
      if (mine !== this.#wish) return false;
      this.#known = found.recordings;
      this.changes = found.changes;
      this.settings = found.settings;
      this.version = found.version;
      const changed = Object.entries(this.changes).map(
        ([key, value]) => `${key.replaceAll("_", " ")} ${Number(value.toPrecision(4))} ${this.settings[key].unit}`,
      );
      write(this.words, `${changed.length ? `With ${changed.join(", ")}: ` : ""}${found.words}`);
      this.#showFields();
      this.view.chart.redraw();
      this.keep.disabled = !changed.length && !this.marks.length;
      return found.is_done === false;
    } catch (error) {
      if (mine === this.#wish) write(this.words, error.message);
      return false;
    }
  }

  async #save() {
    try {
      const saved = await this.#post("settings", {
        changes: this.changes,
        marks: this.#texts(),
        base_version: this.version,
      });
      const count = saved.tests.length;
      const words = count ? `with ${count} ${count === 1 ? "test that passes" : "tests that pass"}` : "without a test";
      write(this.words, `Saved, ${words}.`);
      Object.assign(this, { changes: {}, marks: [] });
      this.keep.disabled = true;
      this.#showMarks();
      this.saving.offer(saved);
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
      const near = this.thresholds.map(this.#dragged).filter((each) => apart_px(each) < NEAR_PX);
      const [found] = near.sort((one, two) => apart_px(one) - apart_px(two));
      if (!found) return;
      if (found.rule !== this.rule) this.use(found.rule);
      this.held = found.key;
      chart.area.setPointerCapture(event.pointerId);
    } else if (!this.held) return;
    else if (event.type === "pointermove")
      this.#set(this.held, Math.max(0.001, Number(chart.metresAt(event.clientY).toPrecision(3))));
    else this.held = null;
    event.preventDefault();
  }

  #dragged = (each) =>
    each.rule === this.rule && this.changes[each.key] ? { ...each, value_m: this.changes[each.key] } : each;

  #draw({ ink, x, y, laneOf, lane, colour }) {
    const top = laneOf(this.rule);
    if (top === undefined) return;
    ink.fillStyle = colour("accent");
    const bar = (from_s, to_s, up, height) =>
      ink.fillRect(x(from_s), top - up, Math.max(2, x(to_s) - x(from_s)), height);
    for (const { began_unix_s, from_s, to_s, after } of this.#known) {
      bar(began_unix_s + from_s, began_unix_s + to_s, lane / 8, lane / 12);
      for (const [begin_s, end_s] of after) bar(began_unix_s + begin_s, began_unix_s + end_s, lane / 2, lane / 2);
    }
    for (const { key, value_m } of this.thresholds.filter(({ rule }) => rule === this.rule).map(this.#dragged)) {
      if (this.changes[key]) ink.fillRect(0, y(value_m), ink.canvas.width, 2);
      this.element.dataset.lineY = y(value_m) / devicePixelRatio; // below the upper edge of the canvas
    }
    ink.textAlign = "left";
    for (const { unix_s, fire } of this.marks) ink.fillText(fire ? "✓" : "✗", x(unix_s) + lane / 3, top - lane);
  }
}
