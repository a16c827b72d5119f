// A distance over time with its thresholds, and below it lanes: when each rule or output was on, in one run or in two.

import { h, replace, svg, write } from "./dom.js";
import { distance, level, UNKNOWN } from "./format.js";

const LEFT = 64; // px, for figures and names
const CURVE = 150;
const LANE = 20;
const SERIES = 4;

/** `data` is `{from_s, to_s, samples: {target: [[at_s, distance_m|null, sigma_m]]}, thresholds_m,
 *  lanes: [{name, runs: [{name, spans: [{from_s, to_s, level}]}]}]}`, where a span without a level is all on. Returns
 *  an element; its slider and the pointer say what was at a moment, `onmoment(at_s)` hears of it. */
export function lanes(data, unit, { title = "", onmoment = () => {} } = {}) {
  const drawing = svg("svg", {
    class: "lanes",
    role: "img",
    "aria-label": [title, summary(data, unit)].filter(Boolean).join(". "),
  });
  const words = h("output", { class: "moment" });
  const slider = h("input", {
    type: "range",
    min: data.from_s,
    max: data.to_s,
    step: Math.max(0.05, (data.to_s - data.from_s) / 2000),
    "aria-label": ["Moment", title].filter(Boolean).join(": "),
    oninput: () => move(Number(slider.value)),
  });
  const element = h("div", { class: "stack" }, drawing, slider, words);
  let at_s = data.from_s;
  const move = (wanted) => {
    at_s = Math.min(data.to_s, Math.max(data.from_s, wanted));
    slider.value = at_s;
    write(words, atMoment(data, at_s, unit));
    slider.setAttribute("aria-valuetext", words.textContent);
    const x = String(place(drawing.clientWidth, data)(at_s));
    const line = drawing.querySelector(".cursor");
    line?.setAttribute("x1", x);
    line?.setAttribute("x2", x);
    onmoment(at_s);
  };
  const follow = ({ clientX, buttons, type }) => {
    if (type === "pointermove" && !buttons) return;
    const box = drawing.getBoundingClientRect();
    move(data.from_s + ((clientX - box.left - LEFT) / Math.max(1, box.width - LEFT - 8)) * (data.to_s - data.from_s));
  };
  drawing.addEventListener("pointerdown", follow);
  drawing.addEventListener("pointermove", follow);
  new ResizeObserver(() => {
    if (!drawing.clientWidth) return;
    draw(drawing, data, unit);
    move(at_s);
  }).observe(element);
  return element;
}

const place =
  (width, { from_s, to_s }) =>
  (at_s) =>
    LEFT + ((at_s - from_s) / Math.max(1e-9, to_s - from_s)) * Math.max(1, width - LEFT - 8);

function draw(root, data, unit) {
  const width = root.clientWidth;
  const rows = data.lanes.flatMap((lane) => lane.runs.map((run, at) => ({ lane, run, at })));
  const height = CURVE + 26 + rows.length * LANE + data.lanes.length * 22;
  root.setAttribute("viewBox", `0 0 ${width} ${height}`);
  root.style.height = `${height}px`;
  const x = place(width, data);
  const line = svg("line", { class: "cursor", x1: LEFT, x2: LEFT, y1: 0, y2: height });
  replace(root, curve(data, unit, x, width), times(data, x), lanesOf(data.lanes, x, width), line);
}

/** The distances with their standard deviation as a band; where nothing was measured, both have a gap. */
function curve({ samples, thresholds_m }, unit, x, width) {
  const known = Object.values(samples)
    .flat()
    .filter(([, distance_m]) => distance_m !== null);
  const most =
    Math.max(
      0.1,
      ...known.map(([, distance_m, sigma_m]) => distance_m + (sigma_m ?? 0)),
      ...thresholds_m.map((each) => each * 1.05),
    ) * 1.05;
  const y = (distance_m) => CURVE - 4 - (Math.max(0, distance_m) / most) * (CURVE - 12);
  const ticks = steps(most / unit.size_m, 4).map((value) => [
    svg("line", { class: "grid", x1: LEFT, x2: width, y1: y(value * unit.size_m), y2: y(value * unit.size_m) }),
    svg("text", { x: LEFT - 8, y: y(value * unit.size_m) + 4, "text-anchor": "end" }, `${value} ${unit.symbol}`),
  ]);
  const limits = thresholds_m.map((each) =>
    svg("line", { class: "threshold", x1: LEFT, x2: width, y1: y(each), y2: y(each) }),
  );
  const drawn = Object.values(samples).map((each, at) => {
    const parts = pieces(each);
    const point = ([at_s, distance_m]) => `${x(at_s).toFixed(1)},${y(distance_m).toFixed(1)}`;
    const edge = (part, sign) =>
      part.map(([at_s, distance_m, sigma_m]) => point([at_s, distance_m + sign * (sigma_m ?? 0)]));
    return svg(
      "g",
      { class: `series-${(at % SERIES) + 1}` },
      parts.map((part) => svg("polygon", { points: [...edge(part, 1), ...edge(part, -1).reverse()].join(" ") })),
      parts.map((part) => svg("polyline", { points: part.map(point).join(" ") })),
    );
  });
  return svg("g", null, ticks, drawn, limits);
}

function pieces(samples) {
  const parts = [[]];
  for (const sample of samples) {
    if (sample[1] !== null) parts.at(-1).push(sample);
    else if (parts.at(-1).length) parts.push([]);
  }
  return parts.filter((part) => part.length);
}

const times = ({ from_s, to_s }, x) => {
  const values = steps(to_s - from_s, 5);
  return svg(
    "g",
    null,
    values.map((value) =>
      svg(
        "text",
        { x: x(from_s + value) + (value ? 0 : 4), y: CURVE + 14, "text-anchor": value ? "middle" : "start" },
        `${value} s`,
      ),
    ),
  );
};

function lanesOf(all, x, width) {
  let y = CURVE + 26;
  return all.map(({ name, runs }) => {
    const title = svg("text", { class: "name", x: 0, y: y + 14 }, name);
    y += 22;
    const drawn = runs.map((run, at) => {
      const top = y;
      y += LANE;
      return [
        svg("text", { x: LEFT - 8, y: top + 13, "text-anchor": "end" }, run.name),
        svg("rect", { class: "lane", x: LEFT, y: top + 2, width: Math.max(0, width - LEFT - 8), height: LANE - 6 }),
        run.spans.map(({ from_s, to_s, level: share = 1 }) =>
          svg("rect", {
            class: `on run-${runs.length === 1 ? 2 : at + 1}`,
            x: x(from_s),
            y: top + 2 + (LANE - 6) * (1 - share),
            width: Math.max(1.5, x(to_s) - x(from_s)),
            height: (LANE - 6) * share,
          }),
        ),
      ];
    });
    return svg("g", null, title, drawn);
  });
}

/** Round values from 0 up to `most`, about `count` of them. */
export function steps(most, count) {
  const rough = Math.max(most, 1e-6) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((each) => each * power).find((each) => each >= rough);
  const decimals = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return Array.from({ length: Math.floor(most / step) + 1 }, (_, at) => Number((at * step).toFixed(decimals)));
}

function atMoment(data, at_s, unit) {
  const measured = Object.entries(data.samples).map(([name, samples]) => `${name} ${measuredAt(samples, at_s, unit)}`);
  const states = data.lanes.map(
    ({ name, runs }) =>
      `${name}: ${runs.map((run) => [run.name, state(run, at_s)].filter(Boolean).join(" ")).join(", ")}`,
  );
  return [`${(at_s - data.from_s).toFixed(1)} s`, ...measured, ...states].join(" · ");
}

function state({ spans }, at_s) {
  const now = spans.find((each) => each.from_s <= at_s && at_s <= each.to_s);
  if (now?.level === undefined) return now ? "on" : "off";
  return level(now.level);
}

function measuredAt(samples, at_s, unit) {
  const before = samples.findLast((each) => each[0] <= at_s) ?? samples[0];
  return before ? distance(before[1], before[2], unit).text : UNKNOWN;
}

/** What the picture shows, for those who cannot see it. */
function summary({ lanes: all, samples, thresholds_m }, unit) {
  const known = Object.values(samples)
    .flat()
    .map((each) => each[1])
    .filter((each) => each !== null);
  const from = known.length
    ? `Distances from ${distance(Math.min(...known), 0, unit).text} to ${distance(Math.max(...known), 0, unit).text}.`
    : "No distances.";
  const limits = thresholds_m.length
    ? `Thresholds: ${thresholds_m.map((each) => distance(each, 0, unit).text).join(", ")}.`
    : "";
  const on = all.flatMap(({ name, runs }) =>
    runs.map((run) => `${[name, run.name].filter(Boolean).join(", ")}: on ${run.spans.length} times.`),
  );
  return [from, limits, ...on].filter(Boolean).join(" ");
}
