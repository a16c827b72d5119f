// The live page: what the camera sees with its distance, what the rules do about it; the rest is folded until wanted.

import { api } from "../../api.js";
import * as format from "../../format.js";
import { Fold, html, Select, useEffect, useKept, useRef, useSnapshot, useState } from "../../ui.js";
import { Chart as Drawn, TimelineChart } from "../timeline/chart.js";
import { dataOf, readAt } from "../timeline/data.js";
import { Events, whatHappened } from "./events.js";
import { Outputs } from "./outputs.js";
import { Picture, Tools } from "./picture.js";
import { Room } from "./room.js";
import { Rules } from "./rules.js";

const EVENTS_MAX = 5;
const CHART_EVERY_MS = 500;
const CHART_PX = 120;
const CHART_STEPS = 300;
const WINDOWS = { 30: "30 s", 60: "1 min", 300: "5 min" };
const CHARTED = new Set(["raised", "cleared", "acknowledged", "reset", "fault", "target_lost"]);

/** It draws nothing by itself when a snapshot comes: its parts do, each at its own pace. */
export const View = (context) => html`<h1 class="sr">Live</h1>
  <div class="live">
    <div class="stack seen"><${Picture} ...${context} /><${Chart} ...${context} /></div>
    <${Told} ...${context} />
  </div>`;

function Told(context) {
  const { live, unit } = context;
  const snapshot = useSnapshot(live);
  if (!snapshot) return html`<p class="panel quiet">The rules and the outputs of the run stand here.</p>`;
  const { rules, outputs, run, figures, messenger, health, recording } = snapshot;
  const { world } = run ?? {};
  const events = live.history.events.slice(0, EVENTS_MAX);
  const notes = health?.notes ?? [];
  const bad = notes.filter(({ is_good }) => !is_good);
  const move = (body) => api.post("world", body);
  const room = html`<${Fold} name="room" title="Simulated room" isOpen>
    <${Room} world=${world} send=${move} ...${context} /><//>`;
  const remembered = html`<${Fold} name="remembered" title="Remembered" isOpen>
    <ul class="list small">${figures?.map((each) => html`<${Remembered} key=${each.name} ...${each} in=${unit} />`)}</ul><//>`;
  return html`<div class="stack done">
    <${Rules} rules=${rules} ...${context} />
    <${Outputs} outputs=${outputs} ...${context} />
    <${Fold} name="tools" title="About the picture" said=${recording && "recording"}>
      <${Tools} snapshot=${snapshot} ...${context} /><//>
    ${world && room}
    <${Fold} name="happened" title="Events" said=${events[0] && whatHappened(events[0])}>
      ${!events.length && html`<p class="quiet">Nothing has happened yet.</p>`}
      <${Events} events=${events} unit=${unit} />
      <p><a href="#alarms">All alarms and events</a></p><//>
    ${figures?.length > 0 && remembered}
    <${Fold} name="health" title="Health" said=${bad.map(({ what }) => what).join(", ") || "good"}>
      <${Notes} notes=${notes} /><//>
    ${messenger && html`<${Messages} ...${snapshot} />`}
  </div>`;
}

const Remembered = ({ name, words, in: unit, ...figure }) => html`<li><strong>${name}</strong>${" "}
  <span class="number">${inUnit(figure, unit)}</span> <span class="quiet">${words}</span></li>`;

/** @param {Record<string, any>} figure */
const inUnit = ({ value, unit: si }, unit) =>
  value === null
    ? "not known"
    : si === "rad"
      ? format.bearing(value)
      : si === "m/s"
        ? format.speed(value, unit)
        : format.distance(value, null, unit).text;

/** The distances of the last minutes: the chart of the timeline, which can only be read here. */
function Chart({ live, unit }) {
  const [span, choose] = useKept("window", "30");
  const [words, say] = useState("");
  const chart = useRef(null);
  const data = useRef(null);
  const onread = (unix_s) => {
    const found = unix_s === null || !data.current ? "" : readAt(data.current, unix_s, unit);
    const said = found && `${format.since(live.snapshot.unix_s - unix_s)} · ${found}`;
    say(said);
    return said;
  };
  const label = "Distances of the last minutes: arrow keys read them";
  chart.current ??= new TimelineChart({ unit, onread, label, height: CHART_PX });
  const snapshot = useSnapshot(live, CHART_EVERY_MS);
  useEffect(() => {
    if (!snapshot) return;
    const from_s = snapshot.unix_s - Number(span);
    const steps = { from_s, step_s: Number(span) / CHART_STEPS, count: CHART_STEPS };
    const { events, ...rest } = dataOf({ ...steps, targets: {}, lanes: [], events: [] }, live);
    data.current = { ...rest, lanes: [], clips: [], events: events.filter(({ kind }) => CHARTED.has(kind)) };
    const limits_m = new Set(snapshot.targets.flatMap(({ thresholds_m }) => thresholds_m));
    chart.current.thresholds = [...limits_m].map((value_m) => ({ rule: "", value_m }));
    chart.current.setView(from_s, snapshot.unix_s);
    chart.current.setData(data.current);
  }, [snapshot, span]);
  return html`<section class="panel chart">
    <div class="row head"><h2>Distance</h2><span class="small number read">${words}</span>
      <${Select} aria-label="How much of the past" options=${WINDOWS} value=${span} choose=${choose} /></div>
    <${Drawn} chart=${chart.current} />
  </section>`;
}

/** Facts, each good or to be looked at. */
const Notes = ({ notes }) => html`<ul class="list health">
  ${notes.map(
    ({ what, words, is_good }) => html`<li key=${what} class="note">
      <span class=${`mark is-${is_good ? "good" : "warning"}`} title=${is_good ? "good" : "look at this"} />
      <strong>${what}</strong><span class="number">${words}</span></li>`,
  )}
</ul>`;

const MAY = { off: "none is taken", alarms: "alarms, and stopping outputs", all: "all" };

function Messages({ messenger: link, messages, now_s, unix_s }) {
  const line = ({ topic, payload }, when) => html`<li><span class="quiet number">${when}</span>${" "}
    <strong>${topic}</strong> <code>${payload}</code></li>`;
  const ago = ({ at_s }) => `${Math.max(0, now_s - at_s).toFixed(0)} s ago`;
  const { undelivered, given_up, dropped } = link;
  const topics = [...link.topics].sort((one, other) => (one.topic < other.topic ? -1 : 1));
  const notes = [
    ["broker", `${link.broker} ${link.trouble ? `: ${link.trouble}` : "connected"}`.trim(), !link.trouble],
    ["base topic", link.base, true],
    ["not delivered", `${undelivered} waiting, ${given_up} given up, ${dropped} dropped`, !(given_up + dropped)],
    ["commands", link.deafness || `${link.commands}: ${MAY[link.commands]}`, !link.deafness],
    ["Home Assistant", link.home_assistant ? `discovers it by ${link.home_assistant}` : "is not told of it", true],
  ];
  const said = link.trouble || "connected";
  return html`<${Fold} name="messages" title="Messages to other programs" said=${said}>
    <${Notes} notes=${notes.map(([what, words, is_good]) => ({ what, words, is_good }))} />
    <details><summary>Topics, each with its newest message</summary>
      <ul class="list small">${topics.map((each) => line(each, ago(each)))}</ul></details>
    <details><summary>The newest messages</summary>
      <ul class="list small">${messages.map((each) => line(each, format.moment(unix_s - now_s + each.at_s)))}</ul>
    </details><//>`;
}
