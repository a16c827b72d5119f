// What an operator may do about a rule now, and the question before it is done: who, why, for how long.

import { ask } from "../../dialog.js";

const SPANS = [["300", "5 minutes"], ["1800", "30 minutes"], ["7200", "2 hours"], ["28800", "8 hours"], ["", "as long as the rule allows"]];

const ACTIONS = {
  ack: { label: "Acknowledge", words: "You have seen it. The alarm stays until its condition is over." },
  reset: { label: "Reset", words: "Ends an alarm that latched. Its condition must be over." },
  shelve: { label: "Shelve", words: "It goes on beneath, drives nothing and notifies nobody, until the time is over." },
  unshelve: { label: "Unshelve", words: "It acts again." },
  "take-out": { label: "Take out", words: "It drives nothing and notifies nobody until it is put back, also after a restart." },
  "put-back": { label: "Put back", words: "It acts again." },
};

const action = (op, more) => ({ op, ...ACTIONS[op], ...more });

/** The actions that a rule has now, the urgent ones first; none for one who may only look. */
export function actionsOf(rule, session) {
  if (session.right !== "operate" || !rule.is_alarm) return [];
  const isShelved = rule.inhibits.includes("shelved");
  const isOut = rule.inhibits.includes("out of service");
  return [
    !rule.acknowledged && action("ack", { isUrgent: true }),
    rule.status === "latched" && action("reset", { isUrgent: true }),
    rule.severity !== "safety" && action(isShelved ? "unshelve" : "shelve"),
    rule.severity !== "safety" && action(isOut ? "put-back" : "take-out"),
  ].filter(Boolean);
}

/** Ask who and why, do it, and say what came of it. An empty rule means every one that it applies to. */
export async function act({ op, label, words }, rule, { api, say }) {
  const fields = [
    op === "shelve" && { name: "for_s", label: "For how long", options: SPANS, value: "1800" },
    op === "shelve" && { name: "one_shot", label: "Ends early", options: [["", "no"], ["yes", "when it has returned to normal"]], value: "" },
    { name: "why", label: "Why", placeholder: "may be left empty", maxLength: 200, autofocus: true },
    { name: "by", label: "Your name", value: localStorage.getItem("name") ?? "", placeholder: "page", maxLength: 60 },
  ].filter(Boolean);
  const given = await ask({ title: rule ? `${label}: ${rule}` : `${label} all`, words, fields, action: label });
  if (!given) return;
  localStorage.setItem("name", given.by);
  const body = { by: given.by || "page", why: given.why };
  if (given.for_s) body.for_s = Number(given.for_s);
  if (given.one_shot) body.one_shot = true;
  try {
    say((await api.post(`rules/${encodeURIComponent(rule)}/${op}`, body))?.words ?? label);
  } catch (error) {
    say(error.message, "error");
  }
}
