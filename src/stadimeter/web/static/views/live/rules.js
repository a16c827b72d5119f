// Each rule with its state and the sentence that says why it acts, or why not; and what an operator may do about it.

import { h, inCode, keyed, replace, write } from "../../dom.js";
import * as format from "../../format.js";
import { act, actionsOf } from "./rule_actions.js";

const LOOKS = { pending: "warning", clearing: "warning", returned: "warning", unknown: "unknown" };

/** What a state looks like: its shape and its colour; its word is always beside them. */
export function lookOf({ status, severity, inhibits, acknowledged, is_alarm }) {
  if (status !== "active" && status !== "latched") return LOOKS[status] ?? "quiet";
  if (inhibits.length) return "warning";
  if (!is_alarm) return "good";
  return severity === "alarm" || severity === "safety" || !acknowledged || status === "latched"
    ? "alarm"
    : severity === "info"
      ? "good"
      : "warning";
}

export function rules(context) {
  const list = h("ul", { class: "list" });
  const none = h("p", { class: "quiet", hidden: true }, "No rule: nothing happens yet. Set-up has a choice of them.");
  const element = h("section", { class: "panel rules" }, h("h2", null, "Rules"), none, list);
  return {
    element,
    update(snapshot) {
      none.hidden = snapshot.rules.length > 0;
      keyed(
        list,
        snapshot.rules,
        (rule) => rule.rule,
        () => card(context),
      );
    },
  };
}

function card(context) {
  const name = h("h3");
  const state = h("span");
  const drives = h("span", { class: "small quiet" });
  const why = h("p", { class: "small" });
  const actions = actionButtons(context);
  const element = h(
    "li",
    { class: "rule" },
    h("div", { class: "row head" }, name, state, drives),
    h("div", { class: "body" }, why, actions),
  );
  element.update = (rule) => {
    write(name, rule.rule);
    state.className = `badge is-${lookOf(rule)}`;
    write(state, stateInWords(rule));
    write(drives, rule.output ? `→ ${rule.output}` : "alert only");
    const words = format.words(whyOnly(rule), context.unit);
    if (why.dataset.words !== words) replace(why, inCode(words)).dataset.words = words;
    actions.update(rule);
  };
  return element;
}

/** The reason without what stands beside it. */
const whyOnly = ({ reason, status, output }) =>
  reason.replace(`${status}: `, "").replace(`; it commands '${output}'`, "");

export function stateInWords(rule) {
  const extra = [
    ...rule.inhibits,
    rule.acknowledged ? "" : "not acknowledged",
    rule.chattering ? "chattering" : "",
    rule.first_out ? "first" : "",
  ];
  return [rule.status, ...extra].filter(Boolean).join(", ");
}

/** The buttons of a rule: what is urgent in sight, the rest behind "More". */
export function actionButtons(context) {
  const urgent = h("div", { class: "lesser urgent" });
  const lesser = h("div", { class: "lesser" });
  const more = h("details", { class: "more" }, h("summary", null, "More"), lesser);
  const element = h("div", { class: "acts" }, more, urgent);
  const fill = (root, actions, rule) =>
    keyed(
      root,
      actions,
      (action) => action.op,
      (action) => button(action, rule, context),
    );
  element.update = (rule) => {
    const actions = actionsOf(rule, context.session);
    element.hidden = !actions.length;
    fill(
      urgent,
      actions.filter((action) => action.isUrgent),
      rule.rule,
    );
    fill(
      lesser,
      actions.filter((action) => !action.isUrgent),
      rule.rule,
    );
  };
  return element;
}

const button = (action, rule, context) =>
  h(
    "button",
    {
      type: "button",
      class: `button ${action.isUrgent ? "primary" : ""}`,
      onclick: () => act(action, rule, context),
      "aria-label": `${action.label}: ${rule}`,
    },
    action.label,
  );
