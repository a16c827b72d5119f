// Alarms: which stand, since when, who has seen them, and what has been.

import { api } from "../api.js";
import * as format from "../format.js";
import { latest } from "../latest.js";
import { AllAlarms } from "../others.js";
import { lookOf, stateInWords } from "../states.js";
import { Badge, Button, html, Select, useEffect, useReducer, useSnapshot, useState } from "../ui.js";
import { Events, SEVERITIES } from "./live/events.js";
import { Actions, act } from "./live/rules.js";

const LEAST = Object.fromEntries(
  SEVERITIES.map((each) => [each, each === "info" ? "everything" : `${each} and above`]),
);
const SLOW_MS = 500;
const AGAIN_MS = 5000;
const SLACK_S = 0.5;

export function View(context) {
  const { live, unit, session, others } = context;
  const snapshot = useSnapshot(live, SLOW_MS);
  const told = useTold(context);
  const [least, choose] = useState("info");
  const [, draw] = useReducer((count) => count + 1, 0);
  useEffect(() => others.watch(draw), [others]);
  const clipOf = session.right === "operate" ? (unix_s) => clipAt(told.clips, unix_s) : () => "";
  const alarms = alarmsOf(snapshot, told);
  const events = eventsOf(live, told).filter(
    ({ severity }) => SEVERITIES.indexOf(severity) >= SEVERITIES.indexOf(least),
  );
  const isSeen = session.right !== "operate" || alarms.every(({ acknowledged }) => acknowledged);
  return html`<div class="stack">
    ${session.has_others && html`<${AllAlarms} others=${others.list} rules=${alarms} />`}
    <section class="panel">
      <div class="row head"><h1>Alarms</h1>
        ${!isSeen && html`<${Button} kind="primary" onclick=${() => act("ack", null, context)}>Acknowledge all<//>`}</div>
      ${!alarms.length && html`<p class="quiet">No rule of this configuration raises an alarm.</p>`}
      <ul class="list alarms">${alarms.map(
        (alarm) =>
          html`<${Alarm} key=${alarm.rule} alarm=${alarm} clip=${clipOf(alarm.raised_unix_s)} ...${context} />`,
      )}</ul>
    </section>
    <section class="panel">
      <div class="row head"><h2>History</h2><label class="row">Show
        <${Select} options=${LEAST} value=${least} choose=${choose} /></label></div>
      ${!events.length && html`<p class="quiet">${told.failed || "Nothing of this kind has happened yet."}</p>`}
      <${Events} events=${events} unit=${unit} clipOf=${clipOf} />
    </section>
  </div>`;
}

/** What the run and the workbench tell of alarms and clips: asked now and then, and when something has happened. */
function useTold({ live }) {
  const [told, set] = useState({ alarms: [], events: [], clips: [], failed: "" });
  useEffect(() => {
    const ask = latest(async (signal) => {
      try {
        const recorded = api.get("recordings", { signal }).catch(() => ({ recordings: [] })); // there may be no workbench
        const { alarms, events } = await api.get("alarms", { signal });
        const clips = (await recorded).recordings.filter(({ clip_of }) => clip_of);
        set({ alarms, events, clips, failed: "" });
      } catch (error) {
        if (!signal.aborted) set((was) => ({ ...was, failed: error.message }));
      }
    });
    let [known] = live.history.events;
    const leave = live.subscribe(
      () => {
        if (live.history.events[0] !== known) ask();
        [known] = live.history.events;
      },
      { image: false },
    );
    ask();
    const often = setInterval(ask, AGAIN_MS);
    return () => (leave(), clearInterval(often), ask.end());
  }, [live]);
  return told;
}

/** Where the clip of a moment is replayed, at that moment; empty for none. */
function clipAt(clips, unix_s) {
  const found = clips.find((each) => each.began_unix_s - SLACK_S <= unix_s && unix_s <= each.ended_unix_s + SLACK_S);
  if (!found) return "";
  return `#recordings/${encodeURIComponent(found.name)}/${Math.max(0, unix_s - found.began_unix_s).toFixed(1)}`;
}

function eventsOf(live, told) {
  const known = new Map([...told.events, ...live.history.events].map((event) => [event.number, event]));
  return [...known.values()].sort((a, b) => b.number - a.number);
}

/** The alarms with what is known of their past; what needs somebody comes first. */
function alarmsOf(snapshot, told) {
  const past = new Map(told.alarms.map((alarm) => [alarm.rule, alarm]));
  const weight = ({ acknowledged, active }) => (acknowledged ? 0 : 2) + (active ? 1 : 0);
  return (snapshot?.rules ?? [])
    .filter(({ is_alarm }) => is_alarm)
    .map((rule) => ({ ...past.get(rule.rule), ...rule }))
    .sort((a, b) => weight(b) - weight(a));
}

const Alarm = ({ alarm, clip, unit, ...context }) => html`<li class="rule">
  <div class="row head"><h2>${alarm.rule}</h2><${Badge} kind=${lookOf(alarm)}>${stateInWords(alarm)}<//></div>
  <div class="body">
    <dl class="facts small">${factsOf(alarm, unit).map(
      ([label, words]) => html`<div key=${label}><dt>${label}</dt><dd>${words}</dd></div>`,
    )}</dl>
    ${clip && html`<a class="button" href=${clip}>Watch the clip</a>`}
    <${Actions} rule=${alarm} ...${context} />
  </div>
</li>`;

function factsOf(alarm, unit) {
  const times = alarm.count > 1 ? `, ${alarm.count} times in this run` : "";
  const seen = `${alarm.acknowledged_by || "somebody"}, ${format.moment(alarm.acknowledged_unix_s)}`;
  return [
    ["why", format.words(alarm.reason ?? "", unit)],
    ["raised", alarm.raised_unix_s && `${format.moment(alarm.raised_unix_s)}${times}`],
    ["cleared", alarm.cleared_unix_s && format.moment(alarm.cleared_unix_s)],
    ["acknowledged", alarm.acknowledged_unix_s && [seen, alarm.why].filter(Boolean).join(": ")],
    ["severity", alarm.severity],
  ].filter(([, words]) => words);
}
