// The pages of other cameras: a bar that says how each is, and one list of the alarms of all.

import { api } from "./api.js";
import { moment, old } from "./format.js";
import { lookOf, stateInWords } from "./states.js";
import { Badge, html } from "./ui.js";

const EVERY_MS = 1000;
const STATES = { asked: "…", live: "live", "no-run": "no run", refused: "refused", silent: "silent" };
const KINDS = { live: "good", "no-run": "warning", refused: "warning", silent: "alarm" };

/** Asks the server of this page what it knows of the others, while there are any and the tab is seen. */
export class Others {
  #readers = new Set();
  list = [];

  constructor({ has_others }) {
    if (has_others) this.#next();
  }

  /** Calls `fn(list)` now and after each answer; returns what ends that. */
  watch(fn) {
    this.#readers.add(fn);
    fn(this.list);
    return () => this.#readers.delete(fn);
  }

  async #next() {
    if (!document.hidden) {
      const { others } = await api.get("others").catch(() => ({ others: this.list }));
      this.list = others;
      for (const fn of this.#readers) fn(others);
    }
    setTimeout(() => this.#next(), EVERY_MS);
  }
}

/** Whether an alarm waits for a person, or is active. */
const stands = ({ acknowledged, status, inhibits }) =>
  !acknowledged || (["active", "clearing", "latched"].includes(status) && !inhibits.length);

const asksForSomebody = (alarm) => stands(alarm) && alarm.severity !== "info";

/** How many of them ask for somebody, in words; empty for none. What only informs stands in the lists. */
export function alarmsInWords(alarms) {
  const count = alarms.filter(asksForSomebody).length;
  return count ? `${count} ${count === 1 ? "alarm" : "alarms"}` : "";
}

const ageOf = ({ state, age_s }) => (state === "live" || age_s === null ? "" : old(age_s * 1000));

/** A link to each page, with how it is, how many alarms stand there, and how old that is where it is not of now. */
export const OthersBar = ({ others }) =>
  others.map((other) => {
    const { url, name, state, words, alarms } = other;
    const count = alarmsInWords(alarms);
    const kind = count && state === "live" ? "alarm" : (KINDS[state] ?? "quiet");
    return html`<a key=${url} class="other" href=${`${url}/#live`} rel="noreferrer" title=${words}>
      <b>${name}</b><${Badge} kind=${kind}>${STATES[state]}<//>
      <span class="small quiet">${[count, ageOf(other)].filter(Boolean).join(", ")}</span></a>`;
  });

/** The alarms that stand, of this camera and of all others, the newest first; each names its camera and leads there. */
export function AllAlarms({ others, rules }) {
  const ours = { url: "", name: "this camera", state: "live", age_s: 0, alarms: rules };
  const all = [ours, ...others].flatMap((camera) => camera.alarms.filter(stands).map((each) => ({ ...each, camera })));
  all.sort((a, b) => (b.raised_unix_s ?? 0) - (a.raised_unix_s ?? 0));
  return html`<section class="panel" aria-label="On all cameras"><h2>On all cameras</h2>
    <ul class="list small">${all.map(({ camera, ...alarm }) => {
      const since = [alarm.raised_unix_s && moment(alarm.raised_unix_s), ageOf(camera)].filter(Boolean).join(", ");
      const kind = lookOf({ ...alarm, is_alarm: true });
      return html`<li key=${`${camera.url} ${alarm.rule}`} class=${`row ${camera.state === "live" ? "" : "is-unknown"}`}>
      <a href=${`${camera.url}/#alarms`}>${camera.name}</a><b>${alarm.rule}</b>
      <${Badge} kind=${kind}>${stateInWords(alarm)}<//><span class="small quiet">${since}</span></li>`;
    })}</ul></section>`;
}
