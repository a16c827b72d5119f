// A range of colours by six sliders, with undo and redo, and what it gives on the ball and on the rest of the picture.

import { Button, html, useEffect, useRef, useState } from "./ui.js";

const CHANNELS = { Hue: 179, Saturation: 255, Value: 255 }; // and the largest number of each
const ONE_STEP_MS = 800; // arrow keys in quick succession are one step of undo
const RANGE = /^[\d\s,]+:[\d\s,]+$/;

/** A range such as "29,86,6:64,255,255" as `[hue from, hue to, saturation from, …]`, and back. */
const numbersOf = (range) => {
  const [lower, upper] = range.split(":").map((each) => each.split(",").map(Number));
  return lower.flatMap((each, at) => [each, upper[at]]);
};
const rangeOf = (numbers) => `${numbers.filter((_, at) => !(at % 2))}:${numbers.filter((_, at) => at % 2)}`;

/** `onrange(range)` hears of each range that a person chooses, and gives it back as `range`; one that comes from
 *  elsewhere is a step that can be undone, too. `figures` say what the range gives. */
export function ColourSliders({ range, onrange, figures }) {
  const [{ steps, at }, set] = useState({ steps: [], at: -1 });
  const moved = useRef({ slider: null, at_ms: 0 });
  const now = steps[at] ?? "";
  const keep = (chosen, inPlace = false) => {
    const before = steps.slice(0, inPlace ? at : at + 1);
    set({ steps: [...before, chosen], at: before.length });
  };
  useEffect(() => {
    if (RANGE.test(range) && range !== now) keep(range);
  }, [range]);
  const numbers = now ? numbersOf(now) : [0, 0, 0, 0, 0, 0];

  const change = (slider, value) => {
    const wanted = numbers.with(slider, value);
    // Hue is a circle, so its lower end may be above the upper one; the others push each other along.
    if (slider > 1 && wanted[slider & ~1] > wanted[slider | 1]) wanted[slider ^ 1] = value;
    const at_ms = performance.now();
    const goesOn = moved.current.slider === slider && at_ms - moved.current.at_ms < ONE_STEP_MS;
    moved.current = { slider, at_ms };
    keep(rangeOf(wanted), goesOn);
    onrange(rangeOf(wanted));
  };
  const go = (by) => {
    if (steps[at + by] === undefined) return;
    moved.current.slider = null;
    set({ steps, at: at + by });
    onrange(steps[at + by]);
  };
  const keyed = (event) => {
    const key = event.key.toLowerCase();
    if (!(event.ctrlKey || event.metaKey) || (key !== "z" && key !== "y")) return;
    event.preventDefault();
    go(key === "y" || event.shiftKey ? 1 : -1);
  };

  const slider = (each, name, end, max) => html`<label class="row"><span class="small">${end}</span>
    <input type="range" min="0" max=${max} step="1" aria-label=${`${name} ${end}`} disabled=${at < 0}
      value=${numbers[each]} oninput=${(event) => change(each, Number(event.target.value))} />
    <output class="number">${numbers[each]}</output></label>`;
  const channel = ([name, max], each) => html`<fieldset class=${`colour-channel is-${name.toLowerCase()}`}>
    <legend>${name}</legend>
    ${slider(2 * each, name, "from", max)}${slider(2 * each + 1, name, "to", max)}</fieldset>`;
  return html`<div class="stack colour-sliders" onkeydown=${keyed}>
    ${Object.entries(CHANNELS).map(channel)}
    <p class="small quiet">${
      numbers[0] > numbers[1] && `Hues from ${numbers[0]} on, through red (0), to ${numbers[1]}.`
    }</p>
    <div class="row"><${Button} disabled=${at < 1} onclick=${() => go(-1)}>Undo<//>
      <${Button} disabled=${at >= steps.length - 1} onclick=${() => go(1)}>Redo<//></div>
    <ul class="small colour-figures" role="status">
      ${figures && inWords(figures).map((each) => html`<li>${each}</li>`)}</ul>
  </div>`;
}

const percent = (share) => `${share > 0 && share < 0.001 ? "less than 0.1" : (100 * share).toFixed(1)} %`;

const inWords = ({ ball_share, elsewhere_px, elsewhere_share, is_found, sigma_share }) => [
  ball_share === null ? "Where the ball is, is not known." : `On the ball: ${percent(ball_share)} of its pixels.`,
  `Elsewhere: ${elsewhere_px} pixels, ${percent(elsewhere_share)} of the rest.`,
  is_found ? `It would be found, its size ± ${percent(sigma_share ?? 0)} (1σ).` : "It would not be found.",
];
