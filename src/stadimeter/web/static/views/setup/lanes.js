// What rules would do, drawn: the distance above, and a lane for each rule and each output below it.

import { h, svg } from "../../dom.js";

const WIDTHS = [340, 600]; // on a phone, and else: the letters keep their size
const LEFT = 8;
const CURVE = 110;
const LANE = 30;

/** A picture of lanes as the server has them, with a title and, for those who cannot see it, a sentence for each rule. */
export function lanesPicture(title, { seconds, rules, outputs, samples }, unit) {
  const width = WIDTHS[Number(innerWidth >= 700)];
  const x = (at_s) => LEFT + (at_s / (seconds || 1)) * (width - 2 * LEFT);
  const curves = Object.values(samples);
  const top_m = 1.1 * Math.max(0.1, ...curves.flat().map(([, distance_m]) => distance_m ?? 0));
  const y = (distance_m) => CURVE - (distance_m / top_m) * (CURVE - 14);
  const lanes = [...rules.map((each) => [each.rule, (row) => stretches(each.active, x, row)]), ...outputs.map((each) => [each.output, (row) => levels(each.steps, seconds, x, row)])];
  const height = CURVE + 26 + lanes.length * LANE;
  return h("figure", { class: "setup-lanes" },
    h("figcaption", null, h("b", null, title), h("span", { class: "quiet small" }, ` ${Math.round(seconds)} s`)),
    svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `${title}. ${inWords(rules, outputs)}` },
      svg("line", { class: "axis", x1: LEFT, x2: width - LEFT, y1: CURVE, y2: CURVE }),
      svg("text", { x: LEFT, y: 11 }, `${(top_m / unit.size_m).toPrecision(2)} ${unit.symbol}`),
      curves.map((curve, index) => svg("path", { class: `curve is-${index + 1}`, d: path(curve, x, y) })),
      lanes.map(([name, draw], index) => {
        const row = CURVE + 22 + index * LANE;
        return svg("g", null, svg("text", { x: LEFT, y: row - 3 }, name), svg("rect", { class: "lane", x: LEFT, width: width - 2 * LEFT, y: row, height: 10 }), draw(row));
      })));
}

/** The curve, with a gap wherever nothing was measured. */
function path(curve, x, y) {
  let isOpen = false;
  return curve.map(([at_s, distance_m]) => {
    const command = distance_m === null ? "" : `${isOpen ? "L" : "M"}${x(at_s).toFixed(1)} ${y(distance_m).toFixed(1)}`;
    isOpen = distance_m !== null;
    return command;
  }).join("");
}

const stretches = (active, x, row) => active.map(({ from_s, to_s }) => svg("rect", { class: "on", x: x(from_s), width: Math.max(2, x(to_s) - x(from_s)), y: row, height: 10 }));

const levels = (steps, seconds, x, row) => steps.map(([at_s, first, second = 0], index) => {
  const level = Math.min(1, Math.max(Math.abs(first), Math.abs(second)));
  const end_s = steps[index + 1]?.[0] ?? seconds;
  return level > 0 && svg("rect", { class: "level", x: x(at_s), width: Math.max(1, x(end_s) - x(at_s)), y: row + 10 * (1 - level), height: 10 * level });
});

const inWords = (rules, outputs) => [
  ...rules.map(({ rule, active }) => `${rule}: ${active.length ? active.map(({ from_s, to_s }) => `active from ${from_s.toFixed(0)} to ${to_s.toFixed(0)} s`).join(", ") : "never active"}`),
  ...outputs.map(({ output, steps }) => `${output}: ${steps.length} steps`),
].join(". ");
