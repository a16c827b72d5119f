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
  picture: [
    ["path", { d: "M12 8h56v44H12z", class: "fill" }],
    ["path", { d: "M12 44l16-18 14 14 8-8 18 18" }],
    ["circle", { cx: 52, cy: 20, r: 5 }],
  ],
  person: [
    ["circle", { cx: 40, cy: 13, r: 8, class: "fill" }],
    ["path", { d: "M28 58V38l-4-6q0-8 8-8h16q8 0 8 8l-4 6v20z", class: "fill" }],
  ],
  face: [
    ["ellipse", { cx: 40, cy: 30, rx: 19, ry: 25, class: "fill" }],
    ["path", { d: "M31 25h4M45 25h4M33 43q7 5 14 0" }],
  ],
  object: [
    ["path", { d: "M12 12h10M12 12v10M68 12h-10M68 12v10M12 48h10M12 48v-10M68 48h-10M68 48v-10" }],
    ["path", { d: "M40 18l14 8v14l-14 8-14-8V26z", class: "fill" }],
  ],
  balls: [20, 40, 60].map((cx, index) => ["circle", { cx, cy: index === 1 ? 40 : 22, r: 12, class: "fill" }]),
  tags: [14, 44].map((x) => [
    "path",
    { d: `M${x} 18h22v22H${x}zM${x + 6} 24v5h5v-5zM${x + 12} 30v5h5v-5z`, "fill-rule": "evenodd", class: "fill" },
  ]),
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
  const isPair = /^width and height/.test(step.question.form);
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
