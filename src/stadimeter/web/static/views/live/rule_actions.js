// What an operator may do about a rule now, and the question before it is done: who, why, for how long.

import { ask } from "../../dialog.js";

const SPANS = [
  ["300", "5 minutes"],
  ["1800", "30 minutes"],
  ["7200", "2 hours"],
  ["28800", "8 hours"],
  ["", "as long as the rule allows"],
];

const ACTIONS = {
  ack: { label: "Acknowledge", words: "You have seen it. The alarm stays until its condition is over." },
  reset: { label: "Reset", words: "Ends an alarm that latched. Its condition must be over." },
  shelve: { label: "Shelve", words: "It goes on beneath, drives nothing and notifies nobody, until the time is over." },
  unshelve: { label: "Unshelve", words: "It acts again." },
  "take-out": {
    label: "Take out",
    words: "It drives nothing and notifies nobody until it is put back, also after a restart.",
  },
  "put-back": { label: "Put back", words: "It acts again." },
  observe: {
    label: "Observe",
    words: "It is judged and explained as before, but drives nothing and sends nothing, also after a restart.",
  },
  act: { label: "Act", words: "It drives its output and notifies again." },
  "set-threshold": {
    label: "Set threshold",
    words: "It stays until it is withdrawn, also after a restart. The configuration is not changed.",
  },
  "withdraw-threshold": {
    label: "Withdraw threshold",
    words: "What was set is withdrawn: the configuration counts again.",
  },
};

const action = (op, more) => ({ op, ...ACTIONS[op], ...more });

/** The actions that a rule has now, the urgent ones first; none for one who may only look. */
export function actionsOf(rule, session) {
  if (session.right !== "operate") return [];
  const isShelved = rule.inhibits.includes("shelved");
  const isObserved = rule.inhibits.includes("observed");
  const isOut = rule.inhibits.includes("out of service");
  return [
    !rule.acknowledged && action("ack", { isUrgent: true }),
    rule.status === "latched" && action("reset", { isUrgent: true }),
    rule.counts && rule.status !== "latched" && action("reset", { words: "It counts anew, from nothing." }),
    rule.severity !== "safety" && action(isShelved ? "unshelve" : "shelve"),
    rule.severity !== "safety" && action(isOut ? "put-back" : "take-out"),
    rule.severity !== "safety" && action(isObserved ? "act" : "observe"),
    rule.severity !== "safety" && action("set-threshold"),
    rule.set_thresholds?.length > 0 && action("withdraw-threshold"),
  ].filter(Boolean);
}

const inUnit = (value, unit) => `${Number(value.toPrecision(6))} ${unit}`;

/** The thresholds of a rule that can be set, with their names. */
async function thresholdsOf(rule, api) {
  const found = (await api.get("status")).rules.find((each) => each.rule === rule)?.thresholds ?? {};
  if (!Object.keys(found).length) throw new Error(`${rule} has no threshold that can be set.`);
  return Object.entries(found);
}

/** Ask who and why, do it, and say what came of it. An empty rule means every one that it applies to. */
export async function act({ op, label, words }, rule, { api, say }) {
  const thresholds =
    op === "set-threshold" ? await thresholdsOf(rule, api).catch((error) => say(error.message, "error")) : [];
  if (!thresholds) return;
  const fields = [
    thresholds.length > 1 && {
      name: "key",
      label: "Which",
      options: thresholds.map(([key, { value, unit }]) => [key, `${key}: ${inUnit(value, unit)}`]),
    },
    thresholds.length > 0 && {
      name: "value",
      label: "Value, with its unit",
      value: thresholds.length > 1 ? "" : inUnit(thresholds[0][1].value, thresholds[0][1].unit),
      placeholder: "60 cm",
      maxLength: 40,
      required: true,
    },
    op === "shelve" && { name: "for_s", label: "For how long", options: SPANS, value: "1800" },
    op === "shelve" && {
      name: "one_shot",
      label: "Ends early",
      options: [
        ["", "no"],
        ["yes", "when it has returned to normal"],
      ],
      value: "",
    },
    { name: "why", label: "Why", placeholder: "may be left empty", maxLength: 200, autofocus: true },
    { name: "by", label: "Your name", value: localStorage.getItem("name") ?? "", placeholder: "page", maxLength: 60 },
  ].filter(Boolean);
  const given = await ask({ title: rule ? `${label}: ${rule}` : `${label} all`, words, fields, action: label });
  if (!given) return;
  localStorage.setItem("name", given.by);
  const body = { by: given.by || "page", why: given.why };
  if (given.for_s) body.for_s = Number(given.for_s);
  if (given.one_shot) body.one_shot = true;
  if (given.key) body.key = given.key;
  if (given.value) body.value = given.value;
  try {
    say((await api.post(`rules/${encodeURIComponent(rule)}/${op}`, body))?.words ?? label);
  } catch (error) {
    say(error.message, "error");
  }
}
