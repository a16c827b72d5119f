// The lens: the target at a distance that is known; or a camera file, or a guess.

import { h } from "../../dom.js";
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
  const live = question.options.find(({ answer }) => LIVE.test(answer));
  if (!live) return choices(step);
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
  step.goes = "Take it";
  if (!step.setup.state.doubt) measured();
  step.below = h(
    "div",
    { class: "stack" },
    room(step.setup),
    others && h("details", null, h("summary", null, "Another way"), others),
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
