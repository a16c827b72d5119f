// A range of colours by six sliders, with undo and redo, and what it gives on the ball and on the rest of the picture.

import { button, h, replace, write } from "./dom.js";

const CHANNELS = [
  ["Hue", 179],
  ["Saturation", 255],
  ["Value", 255],
];
const ONE_STEP_MS = 800; // arrow keys in quick succession are one step of undo

/** `show(range)` takes a range from elsewhere, as a step that can be undone; `tell(figures)` says what one gives.
 *  `onrange(range)` hears of each that a person chooses, such as "29,86,6:64,255,255". */
export function colourSliders(onrange) {
  const steps = [];
  let at = -1;
  let moved = { slider: null, at: 0 };
  const write6 = (numbers) => `${numbers.filter((_, n) => !(n % 2))}:${numbers.filter((_, n) => n % 2)}`;
  const read6 = () => sliders.map((each) => Number(each.value));
  const sliders = CHANNELS.flatMap(([name, max]) =>
    ["from", "to"].map((end) => slider(`${name} ${end}`, max, (event) => changed(event.currentTarget))),
  );
  const values = sliders.map(() => h("output", { class: "number" }));
  const wraps = h("p", { class: "small quiet" });
  const undo = button("Undo", () => go(-1));
  const redo = button("Redo", () => go(1));
  const words = h("ul", { class: "small colour-figures", role: "status" });
  const element = h(
    "div",
    { class: "stack colour-sliders", onkeydown: keyed },
    CHANNELS.map(([name], n) =>
      h(
        "fieldset",
        { class: `colour-channel is-${name.toLowerCase()}` },
        h("legend", null, name),
        [2 * n, 2 * n + 1].map((each) =>
          h(
            "label",
            { class: "row" },
            h("span", { class: "small" }, each % 2 ? "to" : "from"),
            sliders[each],
            values[each],
          ),
        ),
      ),
    ),
    wraps,
    h("div", { class: "row" }, undo, redo),
    words,
  );
  draw();

  function changed(moving) {
    const numbers = read6();
    const n = sliders.indexOf(moving);
    const other = n % 2 ? n - 1 : n + 1;
    // Hue is a circle, so its lower end may be above the upper one; the others push each other along.
    if (n > 1 && numbers[n & ~1] > numbers[n | 1]) sliders[other].value = numbers[n];
    const goesOn = moved.slider === moving && performance.now() - moved.at < ONE_STEP_MS;
    moved = { slider: moving, at: performance.now() };
    keep(write6(read6()), goesOn);
    onrange(steps[at]);
  }

  function keep(range, inPlace = false) {
    steps.length = at + 1;
    if (inPlace) steps[at] = range;
    else at = steps.push(range) - 1;
    draw();
  }

  function go(by) {
    if (steps[at + by] === undefined) return;
    at += by;
    moved = { slider: null, at: 0 };
    put(steps[at]);
    onrange(steps[at]);
  }

  function put(range) {
    const [lower, upper] = range.split(":").map((each) => each.split(","));
    for (const [n, each] of sliders.entries()) each.value = (n % 2 ? upper : lower)[n >> 1].trim();
    draw();
  }

  function draw() {
    for (const each of sliders) each.disabled = at < 0;
    undo.disabled = at < 1;
    redo.disabled = at >= steps.length - 1;
    const numbers = read6();
    for (const [n, value] of values.entries()) write(value, String(numbers[n]));
    write(wraps, numbers[0] > numbers[1] ? `Hues from ${numbers[0]} on, through red (0), to ${numbers[1]}.` : "");
  }

  function keyed(event) {
    if (!(event.ctrlKey || event.metaKey) || !["z", "y"].includes(event.key.toLowerCase())) return;
    event.preventDefault();
    go(event.key.toLowerCase() === "y" || event.shiftKey ? 1 : -1);
  }

  return {
    element,
    get range() {
      return steps[at] ?? "";
    },
    show(range) {
      if (!/^[\d\s,]+:[\d\s,]+$/.test(range) || range === steps[at]) return;
      keep(range);
      put(range);
    },
    tell: (figures) => replace(words, figures ? inWords(figures).map((each) => h("li", null, each)) : []),
  };
}

function slider(name, max, oninput) {
  return h("input", { type: "range", min: 0, max, step: 1, "aria-label": name, disabled: true, oninput });
}

const percent = (share) => `${share > 0 && share < 0.001 ? "less than 0.1" : (100 * share).toFixed(1)} %`;

function inWords({ ball_share, elsewhere_px, elsewhere_share, is_found, sigma_share }) {
  return [
    ball_share === null ? "Where the ball is, is not known." : `On the ball: ${percent(ball_share)} of its pixels.`,
    `Elsewhere: ${elsewhere_px} pixels, ${percent(elsewhere_share)} of the rest.`,
    is_found ? `It would be found, its size ± ${percent(sigma_share ?? 0)} (1σ).` : "It would not be found.",
  ];
}
