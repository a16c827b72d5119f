// The timeline: hours of distances, states of rules, events and clips; a click says what there is to know of a moment.

import { api } from "../../api.js";
import { latest } from "../../latest.js";
import { Button, html, Model, useEffect, useModel } from "../../ui.js";
import { Moment } from "../replay.js";
import { Chart, TimelineChart } from "./chart.js";
import { dataOf, noteStates, readAt } from "./data.js";
import { Judge, Teaching, WhatIf } from "./teaching.js";

const SPANS = { 600: "10 min", 3600: "1 h", 21600: "6 h", 86400: "24 h", 604800: "7 days" };
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

export function View(context) {
  const canOperate = context.session.right === "operate";
  const timeline = useModel(Timeline, context);
  const { chart, moment, read, unit } = timeline;
  const teaching = useModel(Teaching, { view: timeline });
  useEffect(() => timeline.begin(canOperate ? teaching : null), []);
  const toSpan = ([span_s, words]) => html`<${Button} key=${words} label=${`Show ${words}`}
    aria-pressed=${String(timeline.shows(Number(span_s)))} onclick=${() => timeline.showLast(Number(span_s))}>${words}<//>`;
  const way = (sign, label, go) => html`<${Button} label=${label} onclick=${go}>${sign}<//>`;
  const close = () => timeline.put({ moment: null });
  const explained = html`<section class="panel stack moment-told" aria-label="The moment">
    <div class="row"><h2 class="grow">The moment</h2><${Button} onclick=${close}>Close<//></div>
    ${canOperate && html`<${Judge} moment=${moment} teaching=${teaching} />`}
    <${Explained} ...${moment} unit=${unit} /></section>`;
  return html`<div class="stack timeline">
    <section class="panel stack of-run" aria-label="Timeline">
      <div class="row"><h1 class="grow">Timeline</h1><div class="row">${Object.entries(SPANS).map(toSpan)}</div></div>
      <${Chart} chart=${chart} />
      <p class="small number read">${read}</p>
      <div class="row">
        ${way("−", "Zoom out", () => chart.zoom(2))}
        ${way("+", "Zoom in", () => chart.zoom(0.5))}
        ${way("◀", "Earlier", () => chart.scroll(-0.5))}
        ${way("▶", "Later", () => chart.scroll(0.5))}
        ${way("Now", "To now", () => timeline.showLast(chart.to_s - chart.from_s))}</div>
    </section>
    ${moment && explained}
    ${canOperate && html`<${WhatIf} teaching=${teaching} />`}
  </div>`;
}

function Explained({ told, failed, unit }) {
  if (!told) return html`<p class="quiet">${failed ?? "One moment …"}</p>`;
  return html`<p class="quiet small">${TOLD_BY[told.by]}${" "}
      ${told.recording && html`<a href="#recordings">${told.recording}</a>`}</p>
    <${Moment} ...${told} unit=${unit} measured="Measured, mean of that second" />`;
}

class Timeline extends Model {
  follows = true;
  read = "";
  moment = null; // that is explained: `{unix_s, told}`
  #answer = null;
  #digest = null; // of the configuration that the run goes by
  #marks = { clips: [], thresholds: [] };
  #states = new Map(); // of the rules, since this view was opened
  #last_ms = 0;
  chart = new TimelineChart({
    unit: this.unit,
    onview: (_, to_s) => this.#seen(to_s),
    onselect: (unix_s) => this.#explain(unix_s),
    onread: (unix_s) => this.#read(unix_s),
  });

  /** Open with all that is kept, or less where the past is shorter than a day; `teaching` hears of thresholds. */
  begin(teaching) {
    this.teaching = teaching;
    this.timer = setInterval(() => this.load(), RELOAD_MS);
    const leave = this.live.subscribe((snapshot) => this.#update(snapshot), { image: false });
    this.showLast(DAY_S).then(() => {
      const since_s = Date.now() / 1000 - beginOf(this.#answer ?? {});
      const spans = Object.keys(SPANS).map(Number);
      const span_s = spans.find((each) => each >= since_s) ?? DAY_S;
      if (span_s < DAY_S && this.shows(DAY_S)) this.showLast(span_s);
    });
    return leave;
  }

  leave() {
    clearInterval(this.timer);
    clearTimeout(this.quiet);
    this.load.end();
  }

  showLast(span_s) {
    const now_s = Date.now() / 1000;
    this.chart.setView(now_s - span_s, now_s);
    return this.#seen(now_s);
  }

  /** Whether it follows what is live, with as much of the past. */
  shows(span_s) {
    return this.follows && Math.abs(this.chart.to_s - this.chart.from_s - span_s) < 0.01 * span_s;
  }

  /** Live values go on at the right edge, which moves with them while it is in sight. */
  #update(snapshot) {
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
    this.put({ follows: to_s >= Date.now() / 1000 - 2 });
    return this.load();
  }

  #shown = () => dataOf(this.#answer, this.live, this.#states);

  #draw() {
    if (this.#answer) this.chart.setData({ ...this.#shown(), clips: this.#marks.clips });
  }

  /** Ask for what is in view, and something beside it. */
  load = latest(async (signal) => {
    const { from_s, to_s, element } = this.chart;
    const beside_s = MARGIN * (to_s - from_s);
    const points = Math.round(Math.min(POINTS_MAX, (element.clientWidth || 1000) * (1 + 2 * MARGIN)));
    try {
      const view = `from=${Math.max(0, from_s - beside_s)}&to=${to_s + beside_s}`;
      this.#answer = await api.get(`timeline?${view}&points=${points}`, { signal });
      element.dataset.step = this.#answer.step_s;
      this.#draw();
    } catch (error) {
      if (!signal.aborted) this.say(error.message, "error");
    }
    if (!this.#answer?.is_kept) this.put({ read: NOT_KEPT });
    clearTimeout(this.quiet);
    if (!signal.aborted) this.quiet = setTimeout(() => this.loadMarks(), QUIET_MS);
  });

  /** Clips and thresholds, once the view has come to rest: the server answers one question after the other. */
  async loadMarks() {
    const { from_s, step_s, count } = this.#answer ?? { from_s: 0, step_s: 1, count: 1 };
    const found = await api.get(`timeline/marks?from=${from_s}&to=${from_s + step_s * count}`).catch(() => null);
    if (found) this.#marks = found;
    this.chart.thresholds = this.#marks.thresholds;
    this.teaching?.know(this.#marks.thresholds);
    this.#draw();
  }

  #read(unix_s) {
    if (unix_s !== null) this.put({ read: this.#answer ? readAt(this.#shown(), unix_s, this.unit) : "" });
    return this.read;
  }

  async #explain(unix_s) {
    const moment = { unix_s };
    this.put({ moment });
    const found = await api.get(`timeline/moment?at=${unix_s}`).then(
      (told) => ({ told }),
      (error) => ({ failed: error.message }),
    );
    if (this.moment === moment) this.put({ moment: { unix_s, ...found } });
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
