// The distances of the last minutes: a line with its band of ±, thresholds, events, and gaps where none was measured.

import { h, write } from "../../dom.js";
import * as format from "../../format.js";

const WINDOWS = [
  [30, "30 s"],
  [60, "1 min"],
  [300, "5 min"],
];
const GAP_S = 1; // samples further apart are not joined
const EDGE = { left: 46, right: 10, top: 18, bottom: 24 };
const STEPS = [1, 2, 2.5, 5, 10];
const SHOWN_EVENTS = new Set(["raised", "cleared", "acknowledged", "reset", "fault", "target_lost"]);

export function chart({ live, unit }) {
  const canvas = h("canvas", {
    tabIndex: 0,
    role: "slider",
    "aria-label": "Distances of the last minutes: arrow keys read them",
    "aria-valuemin": "0",
  });
  const read = h("p", { class: "small number read", role: "status" });
  const wanted = h(
    "select",
    { "aria-label": "How much of the past", onchange: () => (localStorage.setItem("window", wanted.value), draw()) },
    WINDOWS.map(([value, text]) =>
      h("option", { value, selected: localStorage.getItem("window") === String(value) }, text),
    ),
  );
  const element = h(
    "section",
    { class: "panel chart" },
    h("div", { class: "row head" }, h("h2", null, "Distance"), wanted),
    canvas,
    read,
  );
  let now = null;
  let cursor = null; // seconds ago

  const draw = () =>
    now && drawChart(canvas, { now, history: live.history, unit, window_s: Number(wanted.value), cursor, read });
  const point = (event) => {
    const { left, width } = canvas.getBoundingClientRect();
    const part = (event.clientX - left - EDGE.left) / (width - EDGE.left - EDGE.right);
    cursor = (1 - Math.max(0, Math.min(1, part))) * Number(wanted.value);
    draw();
  };
  const away = () => ((cursor = null), draw());
  canvas.addEventListener("pointermove", point);
  canvas.addEventListener("pointerdown", point);
  canvas.addEventListener("pointerleave", away);
  canvas.addEventListener("blur", away);
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: 1, ArrowDown: 1, ArrowRight: -1, ArrowUp: -1, PageDown: 10, PageUp: -10 }[event.key];
    if (event.key === "Escape") return away();
    if (!step) return;
    event.preventDefault();
    cursor = Math.max(0, Math.min(Number(wanted.value), (cursor ?? 0) + (step * Number(wanted.value)) / 120));
    draw();
  });
  const watch = new ResizeObserver(draw);
  watch.observe(canvas);
  return { element, update: (snapshot) => ((now = snapshot), draw()), takeDown: () => watch.disconnect() };
}

function drawChart(canvas, { now, history, unit, window_s, cursor, read }) {
  const sharp = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (!width) return;
  canvas.width = width * sharp;
  canvas.height = height * sharp;
  const ink = canvas.getContext("2d");
  ink.scale(sharp, sharp);
  const style = getComputedStyle(canvas);
  const colour = (name) => style.getPropertyValue(`--${name}`);
  const since_s = now.now_s - window_s;
  const series = now.targets.map(({ name }, index) => ({
    name,
    colour: colour(`series-${(index % 4) + 1}`),
    samples: within(history.samples[name] ?? [], since_s),
  }));
  const thresholds = [...new Set(now.targets.flatMap((target) => target.thresholds_m))];
  const [low, high] = extent(series, thresholds);
  const area = { left: EDGE.left, right: width - EDGE.right, top: EDGE.top, bottom: height - EDGE.bottom };
  const x = (at_s) => area.left + ((at_s - since_s) / window_s) * (area.right - area.left);
  const y = (metres) => area.bottom - ((metres - low) / (high - low)) * (area.bottom - area.top);
  ink.font = "12px system-ui, sans-serif";
  drawAxes(ink, { area, low, high, y, window_s, unit, quiet: colour("quiet"), line: colour("line") });
  ink.save();
  ink.beginPath();
  ink.rect(area.left, 0, area.right - area.left, height);
  ink.clip();
  for (const threshold of thresholds)
    drawThreshold(
      ink,
      area,
      y(threshold),
      colour("alarm"),
      `${+(threshold / unit.size_m).toFixed(unit.decimals)} ${unit.symbol}`,
    );
  for (const each of series) drawSeries(ink, each, x, y, area);
  const events = history.events.filter((event) => event.at_s >= since_s && SHOWN_EVENTS.has(event.kind));
  for (const event of events) drawEvent(ink, x(event.at_s), event, colour);
  if (cursor !== null) drawCursor(ink, area, x(now.now_s - cursor), colour("ink"));
  ink.restore();
  tell(canvas, read, { series, events, unit, cursor, at_s: now.now_s - (cursor ?? 0), window_s });
}

function within(samples, since_s) {
  let first = samples.length;
  while (first > 0 && samples[first - 1][0] >= since_s) first -= 1;
  return samples.slice(Math.max(0, first - 1));
}

/** The range of the axis: all that was measured, and the thresholds that are near enough to matter. */
function extent(series, thresholds) {
  let [low, high] = [Infinity, -Infinity];
  for (const { samples } of series) {
    for (const [, metres, sigma] of samples) {
      if (metres === null) continue;
      low = Math.min(low, metres - sigma);
      high = Math.max(high, metres + sigma);
    }
  }
  if (low > high)
    [low, high] = thresholds.length ? [Math.min(...thresholds) * 0.8, Math.max(...thresholds) * 1.2] : [0, 3];
  const reach = Math.max(high - low, 0.25);
  for (const each of thresholds)
    if (each > low - 2 * reach && each < high + 2 * reach) [low, high] = [Math.min(low, each), Math.max(high, each)];
  const room = Math.max((high - low) * 0.1, 0.05);
  return [Math.max(0, low - room), high + room];
}

function drawAxes(ink, { area, low, high, y, window_s, unit, quiet, line }) {
  ink.lineWidth = 1;
  ink.fillStyle = quiet;
  ink.strokeStyle = line;
  ink.textBaseline = "middle";
  ink.textAlign = "right";
  const step = niceStep((high - low) / unit.size_m / Math.max(2, (area.bottom - area.top) / 42));
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9) + (String(step).includes("25") ? 1 : 0));
  for (let tick = Math.ceil(low / unit.size_m / step) * step; tick <= high / unit.size_m; tick += step) {
    const at = Math.round(y(tick * unit.size_m)) + 0.5;
    rule(ink, area.left, at, area.right, at);
    ink.fillText(tick.toFixed(decimals), area.left - 6, at);
  }
  ink.textAlign = "left";
  ink.fillText(unit.symbol, 2, 8);
  ink.textBaseline = "alphabetic";
  const parts = area.right - area.left > 500 ? 6 : 3;
  for (let index = 0; index <= parts; index += 1) {
    const at = area.left + ((area.right - area.left) * index) / parts;
    const ago = Math.round(window_s * (1 - index / parts));
    ink.textAlign = index === parts ? "right" : index ? "center" : "left";
    ink.fillText(ago ? `−${ago < 100 ? `${ago} s` : `${+(ago / 60).toFixed(1)} min`}` : "now", at, area.bottom + 17);
  }
}

function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return STEPS.find((each) => each * power >= least) * power;
}

function rule(ink, x1, y1, x2, y2) {
  ink.beginPath();
  ink.moveTo(x1, y1);
  ink.lineTo(x2, y2);
  ink.stroke();
}

function drawThreshold(ink, area, at, colour, words) {
  ink.strokeStyle = colour;
  ink.fillStyle = colour;
  ink.setLineDash([6, 4]);
  ink.lineWidth = 1.5;
  rule(ink, area.left, at, area.right, at);
  ink.setLineDash([]);
  ink.textAlign = "right";
  ink.textBaseline = "bottom";
  ink.fillText(words, area.right - 4, at - 2);
}

/** Runs of samples without a gap; of those that fall on one column of the screen, the last. */
function* runs(samples, x) {
  let run = [];
  for (const [at_s, metres, sigma] of samples) {
    const last = run.at(-1);
    if (metres === null || (last && at_s - last.at_s > GAP_S)) {
      if (run.length) yield run;
      run = [];
    }
    if (metres === null) continue;
    const point = { at_s, x: x(at_s), metres, sigma };
    if (last && run.length > 1 && point.x - run.at(-2).x < 1) run[run.length - 1] = point;
    else run.push(point);
  }
  if (run.length) yield run;
}

function drawSeries(ink, { samples, colour }, x, y) {
  for (const run of runs(samples, x)) {
    ink.fillStyle = colour;
    ink.strokeStyle = colour;
    ink.globalAlpha = 0.22;
    ink.beginPath();
    for (const point of run) ink.lineTo(point.x, y(point.metres + point.sigma));
    for (const point of run.toReversed()) ink.lineTo(point.x, y(point.metres - point.sigma));
    ink.fill();
    ink.globalAlpha = 1;
    ink.lineWidth = 2;
    ink.beginPath();
    for (const point of run) ink.lineTo(point.x, y(point.metres));
    if (run.length === 1) ink.arc(run[0].x, y(run[0].metres), 1.5, 0, 2 * Math.PI);
    ink.stroke();
  }
}

/** A mark above: pointing up where something was raised or went wrong, down where it was over. */
function drawEvent(ink, at, { kind, severity }, colour) {
  const isBad = kind === "raised" || kind === "fault" || kind === "target_lost";
  ink.fillStyle = isBad
    ? colour(severity === "info" ? "quiet" : severity === "warning" ? "warn" : "alarm")
    : colour("good");
  const [tip, base] = isBad ? [3, 13] : [13, 3];
  ink.beginPath();
  ink.moveTo(at, tip);
  ink.lineTo(at - 6, base);
  ink.lineTo(at + 6, base);
  ink.fill();
}

function drawCursor(ink, area, at, colour) {
  ink.strokeStyle = colour;
  ink.lineWidth = 1;
  rule(ink, at, area.top, at, area.bottom);
}

function tell(canvas, read, { series, events, unit, cursor, at_s, window_s }) {
  const figures = series.map(({ name, samples }) => {
    const [, metres, sigma] = nearest(samples, at_s) ?? [0, null];
    return `${name} ${metres === null ? "not measured" : format.distance(metres, sigma, unit).text}`;
  });
  const near = events
    .filter((event) => Math.abs(event.at_s - at_s) < window_s / 60)
    .map((event) => `${event.source} ${event.kind.replaceAll("_", " ")}`);
  const words = [cursor === null ? "" : format.since(cursor), ...figures, ...near].filter(Boolean).join(" · ");
  canvas.setAttribute("aria-valuemax", window_s);
  canvas.setAttribute("aria-valuenow", Math.round(cursor ?? 0));
  canvas.setAttribute("aria-valuetext", words);
  write(read, cursor === null ? legend(series) : words);
}

const legend = (series) =>
  (series.length > 1 ? `${series.map(({ name }) => name).join(", ")}. ` : "") +
  "Point at the chart, or use its arrow keys, to read it.";

function nearest(samples, at_s) {
  let best = null;
  for (const sample of samples) if (!best || Math.abs(sample[0] - at_s) < Math.abs(best[0] - at_s)) best = sample;
  return best && Math.abs(best[0] - at_s) < GAP_S ? best : null;
}
