// Alarms: which stand, since when, who has seen them, and what has been.

import { h, keyed, replace, write } from "../dom.js";
import * as format from "../format.js";
import { drawAllAlarms } from "../others.js";
import { drawEvents, SEVERITIES } from "./live/events.js";
import { act, actionsOf } from "./live/rule_actions.js";
import { actionButtons, lookOf, stateInWords } from "./live/rules.js";

const SLOW_MS = 500;
const ALL = "On all cameras";
const CLIPS_EVERY_MS = 5000;
const SLACK_S = 0.5;

export function mount(root, context) {
  const { api, live, unit, session, others } = context;
  const everywhere = h("ul", { class: "list small" });
  const list = h("ul", { class: "list alarms" });
  const none = h("p", { class: "quiet" }, "No rule of this configuration raises an alarm.");
  const all = h(
    "button",
    {
      type: "button",
      class: "button primary",
      hidden: true,
      onclick: () =>
        act(
          actionsOf({ is_alarm: true, acknowledged: false, inhibits: [], severity: "safety" }, session)[0],
          "",
          context,
        ).then(refresh),
    },
    "Acknowledge all",
  );
  const least = h(
    "select",
    { onchange: () => drawHistory() },
    SEVERITIES.map((each) => h("option", { value: each }, each === "info" ? "everything" : `${each} and above`)),
  );
  const history = h("ol", { class: "list events" });
  const nothing = h("p", { class: "quiet" }, "Nothing.");
  replace(
    root,
    h(
      "div",
      { class: "stack" },
      session.has_others && h("section", { class: "panel", "aria-label": ALL }, h("h2", null, ALL), everywhere),
      h("section", { class: "panel" }, h("div", { class: "row head" }, h("h1", null, "Alarms"), all), none, list),
      h(
        "section",
        { class: "panel" },
        h("div", { class: "row head" }, h("h2", null, "History"), h("label", { class: "row" }, "Show", least)),
        nothing,
        history,
      ),
    ),
  );

  let told = { alarms: [], events: [] };
  let clips = [];
  /** Where the clip of a moment is replayed, at that moment; empty for none. */
  const clipOf = (unix_s) => {
    const found = clips.find((each) => each.began_unix_s - SLACK_S <= unix_s && unix_s <= each.ended_unix_s + SLACK_S);
    if (!found || session.right !== "operate") return "";
    return `#recordings/${encodeURIComponent(found.name)}/${Math.max(0, unix_s - found.began_unix_s).toFixed(1)}`;
  };
  const drawHistory = () => {
    const from = SEVERITIES.indexOf(least.value);
    const known = new Map([...told.events, ...live.history.events].map((event) => [event.number, event]));
    const events = [...known.values()]
      .filter((event) => SEVERITIES.indexOf(event.severity) >= from)
      .sort((a, b) => b.number - a.number);
    nothing.hidden = events.length > 0;
    write(nothing, events.length ? "" : "Nothing of this kind has happened yet.");
    drawEvents(history, events, unit, clipOf);
  };
  const draw = () => {
    const past = new Map(told.alarms.map((alarm) => [alarm.rule, alarm]));
    const rules = (live.snapshot?.rules ?? [])
      .filter((rule) => rule.is_alarm)
      .map((rule) => ({ ...past.get(rule.rule), ...rule }));
    for (const rule of rules) rule.clip = clipOf(rule.raised_unix_s);
    none.hidden = rules.length > 0;
    all.hidden = session.right !== "operate" || rules.every((rule) => rule.acknowledged);
    keyed(
      list,
      rules.sort((a, b) => weight(b) - weight(a)),
      (rule) => rule.rule,
      () => card(context),
    );
    drawAllAlarms(everywhere, others.list, rules);
    drawHistory();
  };
  const refresh = async () => {
    try {
      const recorded = api.get("recordings").catch(() => ({ recordings: [] })); // a page may have no workbench
      told = await api.get("alarms");
      clips = (await recorded).recordings.filter((each) => each.clip_of);
      draw();
    } catch (error) {
      write(nothing, error.message);
    }
  };
  let last = 0;
  let known = live.history.events[0];
  const leave = live.subscribe(
    () => {
      if (live.history.events[0] !== known) refresh();
      known = live.history.events[0];
      if (performance.now() - last < SLOW_MS) return;
      last = performance.now();
      draw();
    },
    { image: false },
  );
  refresh();
  const leaveOthers = others.watch(draw);
  const often = setInterval(refresh, CLIPS_EVERY_MS);
  return () => {
    leave();
    leaveOthers();
    clearInterval(often);
  };
}

/** What needs somebody comes first. */
const weight = ({ acknowledged, active }) => 2 * !acknowledged + Boolean(active);

function card(context) {
  const name = h("h3");
  const state = h("span");
  const facts = h("dl", { class: "facts small" });
  const actions = actionButtons(context);
  const clip = h("a", { class: "button" }, "Watch the clip");
  const body = h("div", { class: "body" }, facts, clip, actions);
  const element = h("li", { class: "rule" }, h("div", { class: "row head" }, name, state), body);
  element.update = (alarm) => {
    write(name, alarm.rule);
    state.className = `badge is-${lookOf(alarm)}`;
    write(state, stateInWords(alarm));
    keyed(facts, factsOf(alarm, context.unit), ([label]) => label, fact);
    Object.assign(clip, { href: alarm.clip, hidden: !alarm.clip });
    actions.update(alarm);
  };
  return element;
}

function fact([label]) {
  const words = h("dd");
  return Object.assign(h("div", null, h("dt", null, label), words), { update: ([, text]) => write(words, text) });
}

function factsOf(alarm, unit) {
  const who =
    alarm.acknowledged_unix_s &&
    [`${alarm.acknowledged_by || "somebody"}, ${format.moment(alarm.acknowledged_unix_s)}`, alarm.why]
      .filter(Boolean)
      .join(": ");
  return [
    ["why", format.words(alarm.reason ?? "", unit)],
    [
      "raised",
      alarm.raised_unix_s &&
        `${format.moment(alarm.raised_unix_s)}${alarm.count > 1 ? `, ${alarm.count} times in this run` : ""}`,
    ],
    ["cleared", alarm.cleared_unix_s && format.moment(alarm.cleared_unix_s)],
    ["acknowledged", who],
    ["severity", alarm.severity],
  ].filter(([, text]) => text);
}
