// Each output as a meter: what it does, who commands it, and a test that lasts while a button is held.

import { api } from "../../api.js";
import * as format from "../../format.js";
import { HoldButton } from "../../hold_button.js";
import { html, useRef, useState } from "../../ui.js";

const MOVES = { forwards: [1, 0], backwards: [-1, 0], "turn left": [0, 1], "turn right": [0, -1] };
const SLOW = { mps: 0.1, radps: 0.3 };

export const Outputs = ({ outputs, ...context }) => html`<section class="panel outputs">
  <h2>Outputs</h2>
  ${!outputs.length && html`<p class="quiet">No output.</p>`}
  <ul class="list">
    ${outputs.map((output) => html`<${Output} key=${output.output} output=${output} ...${context} />`)}
  </ul>
</section>`;

function Output({ output, unit, session }) {
  const { output: name, kind, fault } = output;
  return html`<li class="output">
    <h3>${name}</h3>
    ${kind === "level" ? levelMeter(output) : motionMeters(output, unit)}
    <p class="small quiet">${whoCommands(output, unit)}</p>
    ${fault && html`<p class="small fault">Out of order: ${fault}</p>`}
    ${session.right === "operate" && html`<${Test} name=${name} kind=${kind} />`}
  </li>`;
}

const levelMeter = ({ output, level }) =>
  html`<${Meter} name=${`${output}: level`} part=${level ?? 0} words=${format.level(level ?? 0)} />`;

function motionMeters({ output, ...motion }, unit) {
  const [linear_mps, angular_radps] = [motion.linear_mps ?? 0, motion.angular_radps ?? 0];
  const [along, round] = [linear_mps / (motion.max_linear_mps || 1), -angular_radps / (motion.max_angular_radps || 1)];
  return html`
    <${Meter} name=${`${output}: speed`} isTwoSided part=${along} words=${format.speed(linear_mps, unit)} />
    <${Meter} name=${`${output}: turn`} isTwoSided part=${round} words=${`${angular_radps.toFixed(2)} rad/s`} />`;
}

function whoCommands({ winner, losers, reason, held_by }, unit) {
  const who = held_by ? `held by ${held_by}` : winner === "safe" ? "at its safe value" : `by ${winner}`;
  return `${who}${losers.length ? ` over ${losers.join(", ")}` : ""}${reason ? `: ${format.words(reason, unit)}` : ""}`;
}

/** A bar from its left end, or from its middle for what has two directions: right of it is forwards, or right. */
function Meter({ name, part, words, isTwoSided = false }) {
  const shown = Math.max(-1, Math.min(1, part)) * 100;
  const [left, width] = isTwoSided ? [shown < 0 ? 50 + shown / 2 : 50, Math.abs(shown) / 2] : [0, shown];
  return html`<div class="metered">
    <div class=${`meter ${isTwoSided ? "two-sided" : ""}`} role="meter" aria-label=${name} aria-valuetext=${words}
      aria-valuemin=${isTwoSided ? "-100" : "0"} aria-valuemax="100" aria-valuenow=${Math.round(shown)}>
      <span class="bar" style=${{ left: `${left}%`, width: `${width}%` }} /></div>
    <output class="number">${words}</output>
  </div>`;
}

function Test({ name, kind }) {
  const [said, say] = useState("");
  const level = useRef();
  const path = `outputs/${encodeURIComponent(name)}/hold`;
  const isLevel = kind === "level";
  const held = (label, wish) => {
    const send = async () =>
      (await api.post(path, { ...wish(), by: localStorage.getItem("name") || "page" }))?.words ?? "";
    const release = () => api.post(path, { release: true }, { keepalive: true });
    return html`<${HoldButton} key=${label} label=${label} title="Held only while you press" send=${send}
      release=${release} onWords=${say} />`;
  };
  const move = ([label, [along, round]]) =>
    held(label, () => ({ linear_mps: along * SLOW.mps, angular_radps: round * SLOW.radps }));
  const about = isLevel
    ? "It is on only while you hold the button."
    : "It moves slowly, only while you hold a button. Make room first.";
  const slider = html`<input type="range" min="0" max="100" defaultValue="50" ref=${level}
    aria-label=${`${name}: level of the test, in per cent`} />`;
  return html`<details class="test">
    <summary>Test it</summary>
    <p class="small quiet">${about}</p>
    <div class="row">
      ${isLevel && slider}
      ${isLevel ? held("Hold to test", () => ({ level: level.current.value / 100 })) : Object.entries(MOVES).map(move)}
    </div>
    <p class="small" role="status">${said}</p>
  </details>`;
}
