// The lens: the target at a distance that is known, then at another as proof; or a camera file, or a guess.

import { h, replace, svg } from "../../dom.js";
import { boardWay } from "./board.js";
import { choices } from "./question.js";
import { room } from "./room.js";

const LIVE = /^[\d.]+ m$/;
const KNOWN_TO = [["", "to a hundredth of it"], ["2 mm", "to 2 mm: a good tape"], ["5 mm", "to 5 mm: a tape"], ["1 cm", "to 1 cm: a ruler laid end to end"], ["5 cm", "to 5 cm: by steps"]];

export function widget(step) {
  const { question } = step;
  const isProof = question.key === "proof";
  const live = question.options.find(({ answer }) => LIVE.test(answer));
  if (!live) return choices(step);
  const first = /^([\d.]+)\s*(mm|cm|m|in|ft)/.exec(question.ready) ?? /^([\d.]+)\s*(m)/.exec(live.answer);
  const figure = h("input", { type: "text", inputmode: "decimal", autocomplete: "off", value: first[1], "aria-label": "Distance", "data-first": "", oninput: measured });
  const unit = h("select", { "aria-label": "Unit", onchange: measured }, ["m", "cm", "mm", "ft", "in"].map((each) => h("option", { value: each, selected: each === first[2] }, each)));
  const sigma = h("select", { onchange: measured }, KNOWN_TO.map(([value, words]) => h("option", { value }, words)));
  const seen = h("p", { class: "setup-found", role: "status" });
  const ways = question.options.filter((each) => each !== live);
  const others = ways.length > 0 && h("div", { class: "row" }, ways.map(({ answer, meaning }) =>
    h("button", { type: "button", class: "button setup-way-other", onclick: () => step.submit(answer) }, h("b", null, answer), h("span", { class: "quiet small" }, meaning))));
  step.busyWords = "Taking pictures: hold still …";
  step.goes = isProof ? "Take it as proof" : "Take it";
  if (!step.setup.state.doubt) measured();
  step.picture.mode({ isSaid: true });
  step.picture.onValues((values) => {
    replace(seen, values.found ? `Found, ${Math.round(values.size_px[0])} px across.` : values.words || "Looking …");
    seen.classList.toggle("is-good", values.found);
    seen.classList.toggle("is-warning", !values.found);
  });
  const mover = room(step.setup);
  if (mover) replace(step.picture.below, mover);
  return h("div", { class: "stack" },
    h("div", { class: "field" }, h("span", null, "It is this far from the lens now"), h("div", { class: "setup-size" }, figure, unit)),
    h("label", { class: "field" }, h("span", null, "How well do you know that?"), sigma),
    seen,
    !isProof && boardWay(step),
    others && h("details", null, h("summary", null, isProof ? "Without a proof" : "Another way"), others));

  function measured() {
    const text = `${figure.value.trim().replace(",", ".")} ${unit.value}`;
    step.set(sigma.value ? `${text} ± ${sigma.value}` : text);
  }
}

/** What the camera will be able to see of this target: distance against standard deviation. */
export async function outlook(setup) {
  const { unit } = setup.context;
  const { rows, nearest_m, farthest_m } = await setup.api.post("setup/outlook");
  const length = (value) => `${Number((value / unit.size_m).toPrecision(2))} ${unit.symbol}`;
  const row = ({ distance_m, sigma_m, width_px }) => h("tr", null,
    h("td", null, length(distance_m)), h("td", null, `± ${length(sigma_m)}`), h("td", null, `${((100 * sigma_m) / distance_m).toFixed(1)} %`), h("td", null, `${Math.round(width_px)} px`));
  return h("section", { class: "panel setup-outlook" },
    h("h2", null, "How far this camera sees it"),
    h("p", { class: "quiet small" }, `From ${length(nearest_m)} to ${length(farthest_m)}. ± is one standard deviation.`),
    chart(rows),
    h("table", null, h("thead", null, h("tr", null, ["Distance", "±", "", "Width"].map((name) => h("th", { scope: "col" }, name)))), h("tbody", null, rows.map(row))));
}

/** The standard deviation as a share of the distance, both on logarithmic axes. */
function chart(rows) {
  const xs = rows.map(({ distance_m }) => Math.log(distance_m));
  const ys = rows.map(({ distance_m, sigma_m }) => Math.log(Math.max(1e-6, sigma_m / distance_m)));
  const at = (value, all, from, to) => from + ((value - Math.min(...all)) / (Math.max(...all) - Math.min(...all) || 1)) * (to - from);
  const points = xs.map((x, index) => `${at(x, xs, 8, 312)} ${at(ys[index], ys, 72, 10)}`);
  return svg("svg", { viewBox: "0 0 320 80", class: "setup-chart", role: "img", "aria-label": "± as a share of the distance, from near to far" },
    svg("path", { class: "area", d: `M8 78L${points.join("L")}L312 78Z` }), svg("path", { d: `M${points.join("L")}` }),
    rows.map((_, index) => svg("circle", { cx: points[index].split(" ")[0], cy: points[index].split(" ")[1], r: 2.5 })));
}
