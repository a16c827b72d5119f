// What happened, newest first: each as when, what to whom, why and who.

import * as format from "../../format.js";
import { html } from "../../ui.js";

export const SEVERITIES = ["info", "warning", "alarm", "safety"];
const LOOKS = { info: "quiet", warning: "warning", alarm: "alarm", safety: "alarm" };

/** `clipOf(unix_s)` knows where the clip of a moment is, or nothing. */
export const Events = ({ events, unit, clipOf = (_unix_s) => "" }) => html`<ol class="list events">
  ${events.map((event) => html`<${Event} key=${event.number} ...${event} in=${unit} clip=${clipOf(event.unix_s)} />`)}
</ol>`;

/** @param {Record<string, any>} event */
export const whatHappened = ({ source, kind, by }) => `${source} ${kind.replaceAll("_", " ")}${by ? ` by ${by}` : ""}`;

/** @param {Record<string, any>} props */
const Event = ({ in: unit, clip, ...event }) => html`<li class="event">
  <span class=${`mark is-${LOOKS[event.severity]}`} title=${event.severity} />
  <strong>${whatHappened(event)}</strong>
  <time class="number quiet small">${format.moment(event.unix_s)}</time>
  ${why(event) && html`<span class="reason small">${format.words(why(event), unit)}</span>`}
  ${clip && html`<a class="clip small" href=${clip}>Watch the clip</a>`}
  <span class="sr">(${event.severity})</span>
</li>`;

/** Why it happened, without who did it: that is said above it.
 *  @param {Record<string, any>} event */
const why = ({ reason, by }) =>
  by && reason?.startsWith(`by ${by}`) ? reason.slice(3 + by.length).replace(/^: /, "") : reason;
