// The chart of the timeline, by uPlot: distances with their bands, thresholds, events and clips; below, a lane a rule.

import { lookOf } from "../../states.js";
import { html, useLayoutEffect, useRef } from "../../ui.js";
import uPlot from "../../vendor/uplot/uPlot.js";

const LANE = 30; // px: a name, and its bar below
const BAR = 12;
const TOP = 34; // px above the plot, for clips and events
const PLOT = 280;
const LABEL = "Timeline: arrow keys read it, with Shift they scroll, plus and minus zoom, Enter explains";
const AXIS = 44;
const LABEL_PX = 64; // of a time below the plot, less what stands beside it
const SPAN_MIN_S = 10;
const SPAN_MAX_S = 32 * 86400;
const ZOOM = 1.25;
const TAP_PX = 6; // a pointer that moves less selects
const COLOURS = { good: "good", alarm: "alarm", warning: "warn", unknown: "unknown", quiet: "line" };
const BAD = new Set(["raised", "fault", "target_lost", "stopped", "disarmed", "measurement_lost"]);

/** Where a chart stands; it is taken down with that. */
export function Chart({ chart }) {
  const root = useRef();
  useLayoutEffect(() => {
    root.current.append(chart.element);
    return () => chart.takeDown();
  }, []);
  return html`<div ref=${root} />`;
}

/**
 * `setData({times, targets, lanes, events, clips})` draws: `times` in seconds since 1970, ascending; `targets` by name
 * `{mean_m, sigma_m, low_m, high_m}` with a figure or null for each time; `lanes` `[{rule, spans: [[from_s, to_s,
 * state]]}]`; `events` `[{unix_s, kind, severity, source}]`; `clips` `[{name, from_s, to_s}]`.
 * `rules` are those of the run's snapshot, by name: a lane has the colour that the state of its rule has on every view.
 * `thresholds` is a list of `{rule, target, key, value_m}` to be changed in place or replaced; `redraw()` shows it.
 * `overlays` is a set of `draw({ink, x, y, laneOf, lane, colour})`, called last: `x(unix_s)`, `y(metres)` and
 * `laneOf(rule)` (the upper edge of its bar, or nothing) are in pixels of the page, `lane` is a bar's height.
 * `timeAt(clientX)` and `metresAt(clientY)` read a pointer; `area` is the element over the plot that gets them.
 * `onview(from_s, to_s)` hears of a view that a person chose, `onselect(unix_s)` of a click, a tap, or Enter; without
 * them the chart can only be read. `onread(unix_s)` returns what is at a moment in words, and at null, if none is read.
 */
export class TimelineChart {
  from_s = 0;
  to_s = 1;
  at_s = null;
  unit;
  onview;
  onselect;
  onread;
  height;
  thresholds = [];
  rules = new Map();
  overlays = new Set();
  #data = { times: [], targets: {}, lanes: [], events: [], clips: [] };
  #pointers = new Map();
  #moved = 0;
  #isTaken = false;
  #drawn = 0;

  /** @param {Record<string, any>} options */
  constructor({ unit, onread, onview = null, onselect = null, label = LABEL, height = PLOT }) {
    Object.assign(this, { unit, onview, onselect, onread, height });
    this.element = document.createElement("div");
    this.element.className = "timeline-chart";
    this.element.tabIndex = 0;
    const props = { role: "slider", "aria-valuemin": "0", "aria-valuenow": "0", "aria-label": label };
    for (const [name, value] of Object.entries(props)) this.element.setAttribute(name, value);
    this.element.addEventListener("keydown", (event) => this.#key(event));
    this.scheme = matchMedia("(prefers-color-scheme: dark)");
    this.scheme.addEventListener("change", this.redraw);
    this.watch = new ResizeObserver(() => this.#fit());
    this.watch.observe(this.element);
  }

  takeDown() {
    this.watch.disconnect();
    this.scheme.removeEventListener("change", this.redraw);
    this.plot?.destroy();
  }

  redraw = () => this.plot?.redraw(true, true);

  setView(from_s, to_s) {
    Object.assign(this, { from_s, to_s });
    this.plot?.setScale("x", { min: from_s, max: to_s });
  }

  setData(data) {
    const kind = ({ targets, lanes }) => JSON.stringify([Object.keys(targets), lanes.length]);
    const isOther = !this.plot || kind(data) !== kind(this.#data);
    this.#data = data;
    if (isOther) this.#begin();
    else this.plot.setData(this.#columns(), false);
    this.setView(this.from_s, this.to_s);
  }

  /** The time below a pointer, and the distance. */
  timeAt = (clientX) => this.plot.posToVal(clientX - this.area.getBoundingClientRect().left, "x");
  metresAt = (clientY) => this.plot.posToVal(clientY - this.area.getBoundingClientRect().top, "y") * this.unit.size_m;

  #begin() {
    this.plot?.destroy();
    const names = Object.keys(this.#data.targets);
    const colour = (at) => () => this.#colour(`series-${(at % 4) + 1}`);
    const part = (fill) => ({ show: true, stroke: null, points: { show: false }, fill: undefined, label: fill });
    const series = names.flatMap((name, at) => [
      ...["highest", "lowest", "above", "below"].map((edge) => part(`${name} ${edge}`)),
      { label: name, stroke: colour(at), width: 1.5, points: { size: 3 } },
    ]);
    const bands = names.flatMap((_, at) =>
      [0, 2].map((edge) => ({
        series: [5 * at + 1 + edge, 5 * at + 2 + edge],
        fill: () => faint(this.#colour(`series-${(at % 4) + 1}`), edge ? 0.3 : 0.16),
      })),
    );
    const axis = {
      stroke: () => this.#colour("quiet"),
      font: "12px system-ui, sans-serif",
      grid: { stroke: () => this.#colour("line"), width: 1 },
      ticks: { show: false },
    };
    this.plot = new /** @type {any} */ (uPlot)(
      {
        ...this.#size(),
        bands,
        series: [{}, ...series],
        legend: { show: false },
        padding: [TOP, 10, this.#lanesHeight(), 0],
        cursor: { drag: { x: false, y: false }, y: false, points: { show: false } },
        scales: { x: { time: true }, y: { range: (_, low, high) => this.#range(low, high) } },
        axes: [
          { ...axis, size: AXIS, space: 96, values: timeLabels },
          { ...axis, size: 50, values: (_, values) => values.map((each) => `${each} ${this.unit.symbol}`) },
        ],
        hooks: {
          draw: [() => this.#draw()],
          setCursor: [(plot) => this.#read(plot.cursor.left >= 0 ? plot.posToVal(plot.cursor.left, "x") : this.at_s)],
        },
      },
      this.#columns(),
      this.element,
    );
    this.area = this.plot.over;
    if (!this.onview) return;
    for (const kind of ["pointerdown", "pointermove", "pointerup", "pointercancel"]) {
      this.area.addEventListener(kind, (event) => this.#pointer(event));
    }
    // A finger that drags something on the chart does not scroll the page: pointerdown, which says so, comes first.
    this.area.addEventListener("touchstart", (event) => this.#isTaken && event.preventDefault(), { passive: false });
    this.area.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
  }

  #columns() {
    const scale = (value) => (value === null ? null : value / this.unit.size_m);
    const columns = Object.values(this.#data.targets).flatMap(({ mean_m, sigma_m, low_m, high_m }) => [
      high_m.map(scale),
      low_m.map(scale),
      mean_m.map((mean, at) => (mean === null ? null : scale(mean + sigma_m[at]))),
      mean_m.map((mean, at) => (mean === null ? null : scale(mean - sigma_m[at]))),
      mean_m.map(scale),
    ]);
    return [this.#data.times, ...columns];
  }

  #lanesHeight = () => this.#data.lanes.length * LANE + 6;
  #size = () => ({
    width: Math.max(200, this.element.clientWidth),
    height: TOP + this.height + AXIS + this.#lanesHeight(),
  });
  #colour = (name) => getComputedStyle(this.element).getPropertyValue(`--${name}`);

  #fit() {
    if (this.plot && this.element.clientWidth) this.plot.setSize(this.#size());
  }

  /** All that is in view, and the thresholds that are near enough to matter. */
  #range(low, high) {
    const thresholds = this.thresholds.map(({ value_m }) => value_m / this.unit.size_m);
    if (low === null)
      [low, high] = thresholds.length ? [Math.min(...thresholds), Math.max(...thresholds)] : [0, 3 / this.unit.size_m];
    const reach = Math.max(high - low, 0.25 / this.unit.size_m);
    const near = thresholds.filter((each) => each > low - 2 * reach && each < high + 2 * reach);
    const room = reach * 0.1;
    return [Math.max(0, Math.min(low, ...near) - room), Math.max(high, ...near) + room];
  }

  /** Draws in pixels of the page: the canvas may have more. */
  #draw() {
    const { ctx: ink, bbox } = this.plot;
    const sharp = devicePixelRatio;
    const [left, top, width, height] = ["left", "top", "width", "height"].map((each) => bbox[each] / sharp);
    const x = (unix_s) => left + this.plot.valToPos(unix_s, "x");
    const y = (metres) => top + this.plot.valToPos(metres / this.unit.size_m, "y");
    const colour = (name) => this.#colour(name);
    const bottom = ink.canvas.height / sharp;
    const lanes = new Map(this.#data.lanes.map(({ rule }, at) => [rule, top + height + AXIS + at * LANE]));
    ink.save();
    ink.setTransform(sharp, 0, 0, sharp, 0, 0);
    ink.beginPath();
    ink.rect(left, 0, width, bottom);
    ink.clip();
    ink.font = "12px system-ui, sans-serif";
    this.#drawThresholds(ink, y, left, width);
    const bar = (from_s, to_s, from_px, px, fill) => {
      ink.fillStyle = fill;
      ink.fillRect(x(from_s), from_px, Math.max(2, x(to_s) - x(from_s)), px);
    };
    for (const { from_s, to_s, clip_of } of this.#data.clips)
      bar(from_s, to_s, 2, 8, colour(clip_of ? "accent" : "edge"));
    for (const event of this.#data.events) drawEvent(ink, x(event.unix_s), event, colour);
    for (const { rule, spans } of this.#data.lanes) {
      const lane = lanes.get(rule);
      ink.fillStyle = colour("quiet");
      ink.textAlign = "left";
      ink.textBaseline = "top";
      ink.fillText(rule, left + 2, lane);
      for (const [from_s, to_s, state] of spans) {
        const px = state === "idle" ? 2 : BAR;
        if (to_s > this.from_s && from_s < this.to_s)
          bar(from_s, to_s, lane + 15 + BAR - px, px, colour(this.#look(rule, state)));
      }
    }
    if (this.at_s !== null) bar(this.at_s, this.at_s, 0, bottom, colour("ink"));
    const laneOf = (rule) => lanes.has(rule) && lanes.get(rule) + 15;
    for (const draw of this.overlays) draw({ ink, x, y, laneOf, lane: BAR, colour });
    ink.restore();
    Object.assign(this.element.dataset, { drawn: ++this.#drawn, from: this.from_s, to: this.to_s });
  }

  #look(rule, status) {
    const { is_alarm = true, severity = "info" } = this.rules.get(rule) ?? {};
    return COLOURS[lookOf({ status, is_alarm, severity, inhibits: [], acknowledged: true })];
  }

  #drawThresholds(ink, y, left, width) {
    ink.strokeStyle = ink.fillStyle = this.#colour("alarm");
    ink.lineWidth = 1.5;
    ink.textAlign = "right";
    ink.textBaseline = "bottom";
    const inUnit = (metres) => +(metres / this.unit.size_m).toFixed(this.unit.decimals);
    for (const { rule, value_m } of this.thresholds) {
      ink.setLineDash([6, 4]);
      ink.stroke(new Path2D(`M${left} ${y(value_m)}h${width}`));
      ink.setLineDash([]);
      ink.fillText(`${rule} ${inUnit(value_m)} ${this.unit.symbol}`, left + width - 4, y(value_m) - 2);
    }
  }

  /** Change the view by a person: `part` of it stays where it is. */
  zoom(by, part = 0.5) {
    const span_s = Math.min(SPAN_MAX_S, Math.max(SPAN_MIN_S, (this.to_s - this.from_s) * by));
    const still_s = this.from_s + part * (this.to_s - this.from_s);
    this.#choose(still_s - part * span_s, still_s + (1 - part) * span_s);
  }

  scroll(parts) {
    const by_s = parts * (this.to_s - this.from_s);
    this.#choose(this.from_s + by_s, this.to_s + by_s);
  }

  select(unix_s) {
    this.#move(unix_s);
    this.onselect(unix_s);
  }

  #move(unix_s) {
    this.at_s = unix_s;
    this.#read(unix_s);
    this.redraw();
  }

  #choose(from_s, to_s) {
    this.setView(from_s, to_s);
    this.onview(from_s, to_s);
  }

  #read(unix_s) {
    const words = this.onread(unix_s);
    this.element.setAttribute("aria-valuenow", `${Math.round(unix_s ?? this.to_s)}`);
    this.element.setAttribute("aria-valuetext", words);
  }

  #wheel(event) {
    event.preventDefault();
    const { left, width } = this.area.getBoundingClientRect();
    if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) this.scroll(event.deltaX / width);
    else this.zoom(ZOOM ** Math.max(-3, Math.min(3, event.deltaY / 100)), (event.clientX - left) / width);
  }

  /** One pointer drags, two zoom, and one that hardly moves selects. */
  #pointer(event) {
    const { type, pointerId, clientX } = event;
    const before = [...this.#pointers.values()];
    if (type === "pointerdown") this.#isTaken = event.defaultPrevented;
    if (event.defaultPrevented) return;
    if (type === "pointerdown") {
      if (event.button) return;
      this.area.setPointerCapture(pointerId);
      if (!before.length) this.#moved = 0;
      this.#pointers.set(pointerId, clientX);
    } else if (!this.#pointers.has(pointerId)) {
      return;
    } else if (type === "pointermove") {
      const was = this.#pointers.get(pointerId);
      this.#moved += Math.abs(clientX - was);
      this.#pointers.set(pointerId, clientX);
      const { left, width } = this.area.getBoundingClientRect();
      const after = [...this.#pointers.values()];
      const [one, two] = after;
      if (before.length > 1) this.zoom(apart(before) / apart(after), ((one + two) / 2 - left) / width);
      else if (this.#moved > TAP_PX) this.scroll((was - clientX) / width);
    } else {
      this.#pointers.delete(pointerId);
      if (type === "pointerup" && !this.#pointers.size && this.#moved <= TAP_PX) this.select(this.timeAt(clientX));
    }
  }

  #key(event) {
    const step = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[event.key];
    const [at_s, span_s] = [this.at_s ?? this.to_s, this.to_s - this.from_s];
    if (event.key === "Escape") this.#move(null);
    else if (step && !(event.shiftKey && this.onview)) {
      this.#move(Math.min(this.to_s, Math.max(this.from_s, at_s + (step * span_s) / 120)));
    } else if (!this.onview) return;
    else if (step) this.scroll(step / 4);
    else if (event.key === "PageUp" || event.key === "PageDown") this.scroll(event.key === "PageUp" ? -1 : 1);
    else if (event.key === "+" || event.key === "-")
      this.zoom(event.key === "+" ? 1 / ZOOM : ZOOM, this.at_s === null ? 0.5 : (at_s - this.from_s) / span_s);
    else if (event.key === "Enter") this.select(at_s);
    else return;
    event.preventDefault();
  }
}

/** @param {number[]} places */
const apart = ([one, two]) => Math.max(10, Math.abs(one - two));

const faint = (colour, share) => `color-mix(in srgb, ${colour} ${share * 100}%, transparent)`;

/** Times of this device's clock: with seconds where they differ, and the date where a day begins; none is cut off. */
function timeLabels(plot, times, __, ___, step_s) {
  /** @type {Intl.DateTimeFormatOptions} */
  const clock = { hour: "2-digit", minute: "2-digit", ...(step_s < 60 && { second: "2-digit" }) };
  return times.map((unix_s) => {
    const at = new Date(unix_s * 1000);
    const isDay = at.getHours() + at.getMinutes() + at.getSeconds() === 0;
    if (plot.valToPos(unix_s, "x") > plot.over.clientWidth - LABEL_PX / 2) return "";
    return isDay ? at.toLocaleDateString([], { day: "numeric", month: "short" }) : at.toLocaleTimeString([], clock);
  });
}

/** A mark above: pointing up where something was raised or went wrong, down where it was over. */
function drawEvent(ink, at, { kind, severity }, colour) {
  const isBad = BAD.has(kind);
  const bad = severity === "info" ? "quiet" : severity === "warning" ? "warn" : "alarm";
  ink.fillStyle = colour(isBad ? bad : kind ? "good" : "quiet");
  const [tip, base] = isBad ? [14, 26] : [26, 14];
  ink.fill(new Path2D(`M${at} ${tip}L${at - 5} ${base}H${at + 5}Z`));
}
