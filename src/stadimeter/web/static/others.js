// The pages of other cameras: a bar that says how each is, and one list of the alarms of all.

import { h, keyed, write } from "./dom.js";
import { moment, old } from "./format.js";
import { lookOf, stateInWords } from "./views/live/rules.js";

const EVERY_MS = 1000;
const STATES = { asked: "…", live: "live", "no-run": "no run", refused: "refused", silent: "silent" };
const KINDS = { live: "good", "no-run": "warning", refused: "warning", silent: "alarm" };

/** Asks the server of this page what it knows of the others, while there are any and the tab is seen. */
export class Others {
  #readers = new Set();
  list = [];

  constructor(api, { has_others }) {
    if (has_others) this.#next(api);
  }

  /** Calls `fn(list)` now and after each answer; returns what ends that. */
  watch(fn) {
    this.#readers.add(fn);
    fn(this.list);
    return () => this.#readers.delete(fn);
  }

  async #next(api) {
    if (!document.hidden) {
      const { others } = await api.get("others").catch(() => ({ others: this.list }));
      this.list = others;
      for (const fn of this.#readers) fn(others);
    }
    setTimeout(() => this.#next(api), EVERY_MS);
  }
}

/** Whether an alarm waits for a person, or is active. */
export const stands = ({ acknowledged, status, inhibits }) =>
  !acknowledged || (["active", "clearing", "latched"].includes(status) && !inhibits.length);

/** A link to each page, with how it is, how many alarms stand there, and how old that is where it is not of now. */
export const drawOthers = (root, others) => keyed(root, others, ({ url }) => url, tag);

function tag({ url, name }) {
  const badge = h("span");
  const words = h("span", { class: "small quiet" });
  const element = h("a", { class: "other", href: `${url}/#live`, rel: "noreferrer" }, h("b", null, name), badge, words);
  element.update = (other) => {
    const count = other.alarms.filter(stands).length;
    badge.className = `badge is-${count && other.state === "live" ? "alarm" : (KINDS[other.state] ?? "quiet")}`;
    write(badge, STATES[other.state]);
    write(words, [count && `${count} ${count === 1 ? "alarm" : "alarms"}`, ageOf(other)].filter(Boolean).join(", "));
    element.title = other.words;
  };
  return element;
}

const ageOf = ({ state, age_s }) => (state === "live" || age_s === null ? "" : old(age_s * 1000));

/** The alarms that stand, of this camera and of all others, the newest first; each names its camera and leads there. */
export function drawAllAlarms(root, others, rules) {
  const ours = { url: "", name: "this camera", state: "live", age_s: 0, alarms: rules };
  const all = [ours, ...others].flatMap((camera) => camera.alarms.filter(stands).map((each) => ({ ...each, camera })));
  all.sort((a, b) => (b.raised_unix_s ?? 0) - (a.raised_unix_s ?? 0));
  keyed(root, all, ({ camera, rule }) => `${camera.url} ${rule}`, line);
}

function line({ camera, rule }) {
  const badge = h("span");
  const since = h("span", { class: "small quiet" });
  const where = h("a", { href: `${camera.url}/#alarms` }, camera.name);
  const element = h("li", { class: "row" }, where, h("b", null, rule), badge, since);
  element.update = (alarm) => {
    badge.className = `badge is-${lookOf({ ...alarm, is_alarm: true })}`;
    write(badge, stateInWords(alarm));
    write(since, [alarm.raised_unix_s && moment(alarm.raised_unix_s), ageOf(alarm.camera)].filter(Boolean).join(", "));
    element.classList.toggle("is-unknown", alarm.camera.state !== "live");
  };
  return element;
}
