// Each rule with its state and the sentence that says why it acts, or why not; and what an operator may do about it.

import { h, keyed, write } from "../../dom.js";
import * as format from "../../format.js";
import { actionsOf, act } from "./rule_actions.js";

/** What a state looks like: its shape and its colour; its word is always beside them. */
export const LOOKS = { idle: "quiet", pending: "warning", active: "alarm", clearing: "warning", latched: "alarm", returned: "warning", unknown: "unknown" };

export function rules(context) {
  const list = h("ul", { class: "list" });
  const none = h("p", { class: "quiet" }, "No rule: nothing happens yet. Set-up has a choice of them.");
  const element = h("section", { class: "panel rules" }, h("h2", null, "Rules"), none, list);
  return {
    element,
    update(snapshot) {
      none.hidden = snapshot.rules.length > 0;
      keyed(list, snapshot.rules, (rule) => rule.rule, () => card(context));
    },
  };
}

function card(context) {
  const name = h("h3");
  const state = h("span");
  const drives = h("span", { class: "small quiet" });
  const why = h("p", { class: "small" });
  const buttons = h("div", { class: "row" });
  const element = h("li", { class: "rule" }, h("div", { class: "row head" }, name, state, drives), why, buttons);
  element.update = (rule) => {
    write(name, rule.rule);
    state.className = `badge is-${isActing(rule) ? LOOKS[rule.status] : rule.status === "unknown" ? "unknown" : LOOKS[rule.status] === "alarm" ? "warning" : LOOKS[rule.status]}`;
    write(state, stateInWords(rule));
    write(drives, rule.output ? `→ ${rule.output}` : "alert only");
    write(why, format.words(rule.reason, context.unit));
    keyed(buttons, actionsOf(rule, context.session), (action) => action.op, (action) => actionButton(action, rule.rule, context));
  };
  return element;
}

const isActing = (rule) => !rule.gates.length;

export function stateInWords(rule) {
  const extra = [...rule.gates, rule.acknowledged ? "" : "not acknowledged", rule.chattering ? "chattering" : "", rule.first_out ? "first" : ""];
  return [rule.status, ...extra].filter(Boolean).join(", ");
}

export function actionButton(action, rule, context) {
  return h("button", { type: "button", class: `button ${action.isFirst ? "primary" : "small"}`, onclick: () => act(action, rule, context), "aria-label": `${action.label}: ${rule}` }, action.label);
}
