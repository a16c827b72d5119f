// Each rule with its state and the sentence that says why it acts, or why not; and what an operator may do about it.

import { api } from "../../api.js";
import { ask, askedBy } from "../../dialog.js";
import * as format from "../../format.js";
import { lookOf, stateInWords } from "../../states.js";
import { Badge, Button, html, inCode } from "../../ui.js";

const SPANS = {
  300: "5 minutes",
  1800: "30 minutes",
  7200: "2 hours",
  28800: "8 hours",
  "": "as long as the rule allows",
};
const ONE_SHOT = { "": "no", yes: "when it has returned to normal" };

/** What an operator may do, with the words of its button and of its question. */
const ACTIONS = {
  ack: ["Acknowledge", "You have seen it. The alarm stays until its condition is over."],
  reset: ["Reset", "Ends an alarm that latched. Its condition must be over."],
  shelve: ["Shelve", "It goes on beneath, drives nothing and notifies nobody, until the time is over."],
  unshelve: ["Unshelve", "It acts again."],
  "take-out": ["Take out", "It drives nothing and notifies nobody until it is put back, also after a restart."],
  "put-back": ["Put back", "It acts again."],
  observe: ["Observe", "It is judged as before, but drives nothing and sends nothing, also after a restart."],
  act: ["Act", "It drives its output and notifies again."],
  "set-threshold": ["Set threshold", "It stays until it is withdrawn, also after a restart; the file is as before."],
  "withdraw-threshold": ["Withdraw threshold", "What was set is withdrawn: the configuration counts again."],
};

/** The actions that a rule has now: those that are urgent, and the others; none for one who may only look. */
function actionsOf(rule, { right }) {
  if (right !== "operate") return [[], []];
  const has = (inhibit) => rule.inhibits.includes(inhibit);
  const isLatched = rule.status === "latched";
  const lesser = rule.severity !== "safety" && [
    has("shelved") ? "unshelve" : "shelve",
    has("out of service") ? "put-back" : "take-out",
    has("observed") ? "act" : "observe",
    "set-threshold",
  ];
  return [
    [!rule.acknowledged && "ack", isLatched && "reset"].filter(Boolean),
    [
      rule.counts && !isLatched && "reset",
      ...(lesser || []),
      rule.set_thresholds?.length > 0 && "withdraw-threshold",
    ].filter(Boolean),
  ];
}

export const Rules = ({ rules, ...context }) => html`<section class="panel rules">
  <h2>Rules</h2>
  ${!rules.length && html`<p class="quiet">No rule: nothing happens yet. Set-up has a choice of them.</p>`}
  <ul class="list">${rules.map((rule) => html`<${Rule} key=${rule.rule} rule=${rule} ...${context} />`)}</ul>
</section>`;

const Rule = ({ rule, unit, ...context }) => html`<li class="rule">
  <div class="row head"><h3>${rule.rule}</h3>
    <${Badge} kind=${lookOf(rule)}>${stateInWords(rule)}<//>
    <span class="small quiet">${rule.output ? `→ ${rule.output}` : "alert only"}</span></div>
  <div class="body"><p class="small">${inCode(format.words(whyOnly(rule), unit))}</p>
    <${Actions} rule=${rule} ...${context} /></div>
</li>`;

/** The reason without what stands beside it. */
const whyOnly = ({ reason, status, output }) =>
  reason.replace(`${status}: `, "").replace(`; it commands '${output}'`, "");

/** The buttons of a rule: what is urgent in sight, the rest behind "More". */
export function Actions({ rule, ...context }) {
  const [urgent, lesser] = actionsOf(rule, context.session);
  const each = (kind) => (op) => {
    const [words] = ACTIONS[op];
    const label = `${words}: ${rule.rule}`;
    return html`<${Button} key=${op} kind=${kind} label=${label} onclick=${() => act(op, rule, context)}>${words}<//>`;
  };
  const more = html`<details class="more"><summary>More</summary>
    <div class="lesser">${lesser.map(each(""))}</div></details>`;
  return html`${lesser.length > 0 && more}
    ${urgent.length > 0 && html`<div class="lesser urgent">${urgent.map(each("primary"))}</div>`}`;
}

const inUnit = ({ value, unit }) => `${Number(value.toPrecision(6))} ${unit}`;

/** The thresholds of a rule that can be set, as fields. */
async function thresholdFields(rule) {
  const found = Object.entries((await api.get("status")).rules.find((each) => each.rule === rule)?.thresholds ?? {});
  if (!found.length) throw new Error(`${rule} has no threshold that can be set.`);
  const [[, only]] = found;
  const options = Object.fromEntries(found.map(([key, threshold]) => [key, `${key}: ${inUnit(threshold)}`]));
  const value = found.length > 1 ? "" : inUnit(only);
  return [
    found.length > 1 && { name: "key", label: "Which", options },
    { name: "value", label: "Value, with its unit", value, placeholder: "60 cm", maxLength: 40, required: true },
  ];
}

/** Ask who and why, do it, and say what came of it. Without a rule it means every one that it applies to. */
/** @param {string} op @param {Record<string, any>} rule @param {Record<string, any>} context */
export async function act(op, rule, { say }) {
  const [label, words] = ACTIONS[op];
  const about = op === "reset" && rule.counts && rule.status !== "latched" ? "It counts anew, from nothing." : words;
  const name = rule?.rule ?? "";
  try {
    const fields = [
      ...(op === "set-threshold" ? await thresholdFields(name) : []),
      op === "shelve" && { name: "for_s", label: "For how long", options: SPANS, value: "1800" },
      op === "shelve" && { name: "one_shot", label: "Ends early", options: ONE_SHOT, value: "" },
      ...askedBy(),
    ].filter(Boolean);
    const send = ({ by, why, for_s, one_shot, key, value }) => {
      localStorage.setItem("name", by);
      const body = { by: by || "page", why };
      if (for_s) body.for_s = Number(for_s);
      if (one_shot) body.one_shot = true;
      if (key) body.key = key;
      if (value) body.value = value;
      return api.post(`rules/${encodeURIComponent(name)}/${op}`, body);
    };
    const done = await ask({
      title: name ? `${label}: ${name}` : `${label} all`,
      words: about,
      fields,
      action: label,
      send,
    });
    if (done) say(done.answer?.words ?? label);
  } catch (error) {
    say(error.message, "error");
  }
}
