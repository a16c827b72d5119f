// The lens: the target at a distance that is known, then at another as proof; or a camera file, or a guess.

import { h, svg } from "../../dom.js";
import { steps } from "../../lanes.js";
import { boardWay } from "./board.js";
import { distances } from "./pictures.js";
import { choices } from "./question.js";
import { room } from "./room.js";

const LIVE = /^[\d.]+ m$/;
const KNOWN_TO = [
  ["", "to a hundredth of it"],
  ["2 mm", "to 2 mm: a good tape"],
  ["5 mm", "to 5 mm: a tape"],
  ["1 cm", "to 1 cm: a ruler laid end to end"],
  ["5 cm", "to 5 cm: by steps"],
];

export function widget(step) {
  const { question } = step;
  const isProof = question.key === "proof";
  const live = question.options.find(({ answer }) => LIVE.test(answer));
  if (!live && step.setup.state.pictures.length && !/not known/.test(question.text)) return distances(step);
  if (!live) return ((step.below = boardWay(step)), choices(step));
  const first = /^([\d.,]+)\s*(mm|cm|m|in|ft)/.exec(question.ready) ?? /^([\d.]+)\s*(m)/.exec(live.answer);
  const figure = h("input", {
    type: "text",
    inputmode: "decimal",
    autocomplete: "off",
    value: first[1],
    "aria-label": "Distance",
    "data-first": "",
    oninput: measured,
  });
  const unit = h(
    "select",
    { "aria-label": "Unit", onchange: measured },
    ["m", "cm", "mm", "ft", "in"].map((each) => h("option", { value: each, selected: each === first[2] }, each)),
  );
  const sigma = h(
    "select",
    { onchange: measured },
    KNOWN_TO.map(([value, words]) => h("option", { value }, words)),
  );
  const ways = question.options.filter((each) => each !== live);
  const others =
    ways.length > 0 &&
    h(
      "div",
      { class: "row" },
      ways.map(({ answer, meaning }) =>
        h(
          "button",
          { type: "button", class: "button setup-way-other", onclick: () => step.submit(answer) },
          h("b", null, answer),
          h("span", { class: "quiet small" }, meaning),
        ),
      ),
    );
  step.busyWords = "Taking pictures: hold still …";
  step.goes = isProof ? "Take it as proof" : "Take it";
  if (!step.setup.state.doubt) measured();
  step.below = h(
    "div",
    { class: "stack" },
    room(step.setup),
    !isProof && boardWay(step),
    others && h("details", null, h("summary", null, isProof ? "Without a proof" : "Another way"), others),
  );
  return h(
    "div",
    { class: "stack" },
    h(
      "div",
      { class: "field" },
      h("span", null, "It is this far from the lens now"),
      h("div", { class: "setup-size" }, figure, unit),
    ),
    h("label", { class: "field" }, h("span", null, "How well do you know that?"), sigma),
  );

  function measured() {
    const text = `${figure.value.trim()} ${unit.value}`;
    step.set(sigma.value ? `${text} ± ${sigma.value}` : text);
  }
}

/** What the camera will be able to see of this target: distance against standard deviation. */
export async function outlook(setup) {
  const { unit } = setup.context;
  const { rows, nearest_m, farthest_m } = await setup.api.post("setup/outlook");
  const length = (value) => `${Number((value / unit.size_m).toPrecision(2))} ${unit.symbol}`;
  const row = ({ distance_m, sigma_m, width_px }) =>
    h(
      "tr",
      null,
      h("td", null, length(distance_m)),
      h("td", null, `± ${length(sigma_m)}`),
      h("td", null, `${((100 * sigma_m) / distance_m).toFixed(1)} %`),
      h("td", null, `${Math.round(width_px)} px`),
    );
  return h(
    "section",
    { class: "panel setup-outlook" },
    h("h2", null, "How far this camera sees it"),
    h(
      "p",
      { class: "quiet small" },
      `From ${length(nearest_m)} to ${length(farthest_m)}. ± is one standard deviation.`,
    ),
    chart(rows, unit),
    h(
      "table",
      null,
      h(
        "thead",
        null,
        h(
          "tr",
          null,
          ["Distance", "±", "Share", "Width"].map((name) => h("th", { scope: "col" }, name)),
        ),
      ),
      h("tbody", null, rows.map(row)),
    ),
  );
}

/** The standard deviation as a share of the distance, which is on a logarithmic axis. */
function chart(rows, unit) {
  const [left, right, top, bottom] = [44, 298, 10, 122];
  const [near, far] = [rows[0].distance_m, rows.at(-1).distance_m];
  const shares = rows.map(({ distance_m, sigma_m }) => (100 * sigma_m) / distance_m);
  const most = 1.15 * Math.max(0.1, ...shares);
  const x = (metres) => left + ((right - left) * Math.log(metres / near)) / (Math.log(far / near) || 1);
  const y = (share) => bottom - ((bottom - top) * share) / most;
  const points = rows.map(({ distance_m }, index) => `${x(distance_m).toFixed(1)} ${y(shares[index]).toFixed(1)}`);
  const round = [-3, -2, -1, 0, 1, 2, 3].flatMap((power) =>
    [1, 2, 5].map((each) => Number((each * 10 ** power).toPrecision(1))),
  );
  const at = round.filter((each) => each * unit.size_m >= near && each * unit.size_m <= far);
  return svg(
    "svg",
    {
      viewBox: "0 0 320 142",
      class: "setup-chart",
      role: "img",
      "aria-label": "± as a share of the distance, from near to far",
    },
    steps(most, 3).map((each) => [
      svg("line", { x1: left, x2: right, y1: y(each), y2: y(each) }),
      svg("text", { x: left - 6, y: y(each) + 4, "text-anchor": "end" }, `${each} %`),
    ]),
    at.map((each) => [
      svg("line", { x1: x(each * unit.size_m), x2: x(each * unit.size_m), y1: bottom, y2: bottom + 4 }),
      svg("text", { x: x(each * unit.size_m), y: bottom + 16, "text-anchor": "middle" }, `${each} ${unit.symbol}`),
    ]),
    svg("path", { class: "area", d: `M${left} ${bottom}L${points.join("L")}L${right} ${bottom}Z` }),
    svg("path", { d: `M${points.join("L")}` }),
    points.map((point) => svg("circle", { cx: point.split(" ")[0], cy: point.split(" ")[1], r: 2.5 })),
  );
}
