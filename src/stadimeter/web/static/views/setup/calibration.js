// The lens: the target at a distance that is known; or a camera file, or a guess.

import { Field, html } from "../../ui.js";
import { Choices } from "./form.js";

const LIVE = /^[\d.]+ m$/;
const liveOf = ({ options }) => options.find(({ answer }) => LIVE.test(answer));

export function Widget({ step }) {
  const { question, answer, isDoubted } = step;
  const live = liveOf(question);
  if (!live) return html`<${Choices} step=${step} />`;
  const label = "It is this far from the lens now; with ± how well you know it, such as 1 m ± 5 mm";
  return html`<${Field} label=${label}><input type="text" autocomplete="off" data-first=""
    value=${isDoubted ? live.answer : answer} oninput=${(event) => step.set(event.target.value)} /><//>`;
}

/** The way on: a picture is taken now; the other ways stand below it. */
export const wayOf = ({ question }) =>
  liveOf(question) ? { goes: "Take it", busy: "Taking pictures: hold still …", Below: Ways } : {};

function Ways({ step }) {
  const { question } = step;
  const way = ({ answer, meaning }) => html`<button type="button" class="button setup-way-other"
    onclick=${() => step.send(answer)}><b>${answer}</b><span class="quiet small">${meaning}</span></button>`;
  return html`<details><summary>Another way</summary>
    <div class="row setup-group">${question.options.filter((each) => each !== liveOf(question)).map(way)}</div></details>`;
}
