// The timeline: hours of distances, states of rules, events and clips; a click says what there is to know of a moment.

import { button, h, replace, write } from "../../dom.js";
import { latest } from "../../latest.js";
import { describe } from "../replay.js";
import { TimelineChart } from "./chart.js";
import { dataOf, noteStates, readAt } from "./data.js";
import { Teaching } from "./teaching.js";

const SPANS = [
  [600, "10 min"],
  [3600, "1 h"],
  [21600, "6 h"],
  [86400, "24 h"],
  [604800, "7 days"],
];
const DAY_S = 86400;
const POINTS_MAX = 1600;
const MARGIN = 0.5; // as much of the view is loaded beside it, so that scrolling shows something at once
const FOLLOW_MS = 1000;
const RELOAD_MS = 60_000; // the run writes as often
const QUIET_MS = 600;
const NOT_KEPT =
  "This run keeps no timeline: only what is live is shown. A table [timeline] in its configuration lets it keep one.";

const TOLD_BY = {
  run: "By the run itself.",
  recording: "By a recording of that time.",
  timeline: "No recording holds this moment: this is what the timeline and the event log know.",
};

export function mount(root, context) {
  const view = new Timeline(context);
  replace(root, view.element);
  view.begin();
  const leave = context.live.subscribe((snapshot) => view.update(snapshot), { image: false });
  return () => {
    leave();
    view.takeDown();
  };
}

class Timeline {
  #answer = null;
  #digest = null; // of the configuration that the run goes by
  #marks = { clips: [], thresholds: [] };
  #states = new Map(); // of the rules, since this view was opened
  #last_ms = 0;

  constructor({ api, live, unit, say, session }) {
    Object.assign(this, { api, live, unit, say, follows: true });
    this.chart = new TimelineChart({
      unit,
      onview: (_, to_s) => this.#seen(to_s),
      onselect: (unix_s) => this.#explain(unix_s),
      onread: (unix_s) => this.#read(unix_s),
    });
    this.read = h("p", { class: "small number read" });
    this.moment = h("section", { class: "panel stack moment-told", "aria-label": "The moment", hidden: true });
    const named = (words, label, onclick) => button(words, onclick, "", { "aria-label": label });
    this.spans = SPANS.map(([span_s, words]) => named(words, `Show ${words}`, () => this.showLast(span_s)));
    this.element = h(
      "div",
      { class: "stack timeline" },
      h(
        "section",
        { class: "panel stack of-run", "aria-label": "Timeline" },
        h("div", { class: "row" }, h("h1", { class: "grow" }, "Timeline"), this.spans),
        this.chart.element,
        this.read,
        h(
          "div",
          { class: "row" },
          named("−", "Zoom out", () => this.chart.zoom(2)),
          named("+", "Zoom in", () => this.chart.zoom(0.5)),
          named("◀", "Earlier", () => this.chart.scroll(-0.5)),
          named("▶", "Later", () => this.chart.scroll(0.5)),
          named("Now", "To now", () => this.showLast(this.chart.to_s - this.chart.from_s)),
        ),
      ),
      this.moment,
    );
    this.teaching = session.right === "operate" ? new Teaching(this) : null;
    if (this.teaching) this.element.append(this.teaching.element);
  }

  /** Open with all that is kept, or less where the past is shorter than a day. */
  async begin() {
    this.timer = setInterval(() => this.load(), RELOAD_MS);
    await this.showLast(DAY_S);
    const since_s = Date.now() / 1000 - beginOf(this.#answer ?? {});
    const [span_s] = SPANS.find(([each]) => each >= since_s) ?? [DAY_S];
    const isUntouched = this.follows && Math.abs(this.chart.to_s - this.chart.from_s - DAY_S) < 1;
    if (span_s < DAY_S && isUntouched) this.showLast(span_s);
  }

  takeDown() {
    clearInterval(this.timer);
    clearTimeout(this.quiet);
    this.load.end();
    this.chart.takeDown();
  }

  showLast(span_s) {
    const now_s = Date.now() / 1000;
    this.chart.setView(now_s - span_s, now_s);
    return this.#seen(now_s);
  }

  /** Live values go on at the right edge, which moves with them while it is in sight. */
  update(snapshot) {
    if (performance.now() - this.#last_ms < FOLLOW_MS) return;
    this.#last_ms = performance.now();
    noteStates(this.#states, snapshot);
    this.chart.rules = new Map(snapshot.rules.map((rule) => [rule.rule, rule]));
    const { digest } = snapshot.run ?? {};
    if (this.#digest && digest !== this.#digest) this.loadMarks(); // its thresholds may be others
    this.#digest = digest;
    if (this.follows && snapshot.unix_s > this.chart.to_s) {
      this.chart.setView(this.chart.from_s + snapshot.unix_s - this.chart.to_s, snapshot.unix_s);
    }
    this.#draw();
  }

  #seen(to_s) {
    this.follows = to_s >= Date.now() / 1000 - 2;
    const span_s = this.chart.to_s - this.chart.from_s;
    for (const [at, [each_s]] of SPANS.entries())
      this.spans[at].setAttribute("aria-pressed", String(this.follows && Math.abs(span_s - each_s) < 0.01 * each_s));
    return this.load();
  }

  #draw() {
    if (!this.#answer) return;
    this.chart.setData({ ...dataOf(this.#answer, this.live, this.#states), clips: this.#marks.clips });
  }

  /** Ask for what is in view, and something beside it. */
  load = latest(async (signal) => {
    const { from_s, to_s, element } = this.chart;
    const beside_s = MARGIN * (to_s - from_s);
    const points = Math.round(Math.min(POINTS_MAX, (element.clientWidth || 1000) * (1 + 2 * MARGIN)));
    const query = new URLSearchParams({ from: Math.max(0, from_s - beside_s), to: to_s + beside_s, points });
    try {
      this.#answer = await this.api.get(`timeline?${query}`, { signal });
      element.dataset.step = this.#answer.step_s;
      this.#draw();
    } catch (error) {
      if (!signal.aborted) this.say(error.message, "error");
    }
    if (!this.#answer?.is_kept) write(this.read, NOT_KEPT);
    clearTimeout(this.quiet);
    if (!signal.aborted) this.quiet = setTimeout(() => this.loadMarks(), QUIET_MS);
  });

  /** Clips and thresholds, once the view has come to rest: the server answers one question after the other. */
  async loadMarks() {
    const { from_s, step_s, count } = this.#answer ?? { from_s: 0, step_s: 1, count: 1 };
    const found = await this.api.get(`timeline/marks?from=${from_s}&to=${from_s + step_s * count}`).catch(() => null);
    if (found) this.#marks = found;
    this.chart.thresholds = this.#marks.thresholds;
    this.teaching?.know(this.#marks.thresholds);
    this.#draw();
  }

  #read(unix_s) {
    if (unix_s === null) return this.read.textContent;
    const words = this.#answer ? readAt(dataOf(this.#answer, this.live, this.#states), unix_s, this.unit) : "";
    write(this.read, words);
    return words;
  }

  async #explain(unix_s) {
    const head = h(
      "div",
      { class: "row" },
      h("h2", { class: "grow" }, "The moment"),
      button("Close", () => (this.moment.hidden = true)),
    );
    this.moment.hidden = false;
    replace(this.moment, head, this.teaching?.buttons(unix_s), h("p", { class: "quiet" }, "One moment …"));
    let known = {};
    const told = await this.api.get(`timeline/moment?at=${unix_s}`).then(
      (found) => [
        h(
          "p",
          { class: "quiet small" },
          TOLD_BY[found.by],
          " ",
          found.recording && h("a", { href: "#recordings" }, found.recording),
        ),
        describe((known = found), this.unit, "Measured, mean of that second"),
      ],
      (error) => h("p", null, error.message),
    );
    replace(this.moment, head, this.teaching?.buttons(unix_s, known), told);
  }
}

/** When the first of what is kept was: a distance, a state or an event. */
function beginOf({ from_s = 0, step_s, targets = {}, lanes = [], events = [] }) {
  const firsts = Object.values(targets).map(({ mean_m }) => mean_m.findIndex((each) => each !== null));
  return Math.min(
    Date.now() / 1000,
    ...firsts.filter((at) => at >= 0).map((at) => from_s + at * step_s),
    ...lanes.flatMap(({ spans }) => spans.map(([begin_s]) => begin_s)),
    ...events.map(({ unix_s }) => unix_s),
  );
}
