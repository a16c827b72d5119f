// The target: its kind, drawn, and its size.

import { h, svg } from "../../dom.js";
import { choices } from "./question.js";

const DRAWN = {
  ball: [
    ["circle", { cx: 40, cy: 30, r: 22, class: "fill" }],
    ["path", { d: "M24 15c10 8 10 22 0 30M56 15c-10 8-10 22 0 30" }],
  ],
  sheet: [
    ["path", { d: "M22 4h28l10 10v42H22z", class: "fill" }],
    ["path", { d: "M50 4v10h10M30 26h22M30 34h22M30 42h14" }],
  ],
  tag: [
    ["path", { d: "M14 4h52v52H14z", class: "fill" }],
    [
      "path",
      {
        class: "dark",
        d: "M19 9h42v42H19zM27 17v8h8v-8zM43 17v16h10V17zM27 35v8h10v-8zM45 37v6h8v-6z",
        "fill-rule": "evenodd",
      },
    ],
  ],
  disc: [
    ["ellipse", { cx: 40, cy: 33, rx: 32, ry: 20 }],
    ["ellipse", { cx: 40, cy: 29, rx: 32, ry: 20, class: "fill" }],
  ],
};
const UNITS = ["cm", "mm", "m", "in", "ft"];
const FIGURE = /^\s*([\d.,]+)\s*(mm|cm|m|in|ft)\s*$/;
const BETWEEN = /(?<!\d),|,(?!\d)/; // as the server splits a list: a comma between digits belongs to a number

export const widget = (step) => (step.question.key === "target" ? kinds(step) : size(step));

const kinds = (step) =>
  choices(step, {
    draw: ({ answer }) =>
      svg(
        "svg",
        { viewBox: "0 0 80 60", class: "setup-drawn", "aria-hidden": "true" },
        (DRAWN[answer] ?? []).map(([tag, props]) => svg(tag, props)),
      ),
  });

/** A name that many have, or a figure with its unit. */
function size(step) {
  const names = step.question.names ?? [];
  const isPair = step.setup.state.answers.some(({ key, answer }) => key === "target" && answer === "sheet");
  const figure = h("input", {
    type: "text",
    inputmode: "decimal",
    autocomplete: "off",
    "aria-label": isPair ? "Width" : "Size",
    oninput: measured,
  });
  const second =
    isPair &&
    h("input", { type: "text", inputmode: "decimal", autocomplete: "off", "aria-label": "Height", oninput: measured });
  const unit = h(
    "select",
    { "aria-label": "Unit", onchange: measured },
    UNITS.map((each) => h("option", { value: each }, each)),
  );
  const named =
    names.length > 0 &&
    h(
      "select",
      { "data-first": "", onchange: () => named.value && step.set(named.value) },
      h("option", { value: "" }, "measured by you"),
      names.map((each) => h("option", { value: each }, each)),
    );
  function measured() {
    const sides = [figure, second].filter(Boolean).map((each) => `${each.value.trim()} ${unit.value}`);
    step.set(sides.join(", "));
  }
  step.onAnswer((answer) => {
    const sides = answer.split(BETWEEN).map((each) => FIGURE.exec(each));
    if (named) named.value = names.includes(answer) ? answer : "";
    if (document.activeElement === figure || document.activeElement === second) return;
    figure.value = sides[0]?.[1] ?? "";
    if (second) second.value = sides[1]?.[1] ?? "";
    unit.value = sides[0]?.[2] ?? unit.value;
  });
  if (!named) figure.dataset.first = "";
  return h(
    "div",
    { class: "stack" },
    named && h("label", { class: "field" }, h("span", null, "It is a"), named),
    h(
      "div",
      { class: "field" },
      h("span", null, isPair ? "Width and height, if you measured them" : "Its size, if you measured it"),
      h("div", { class: "setup-size" }, figure, second && h("span", { "aria-hidden": "true" }, "×"), second, unit),
    ),
  );
}
