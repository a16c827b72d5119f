// What shall happen: wishes to choose from, their blanks in a sentence, and what they would do.

import { h, inCode, replace } from "../../dom.js";
import { lanes } from "../../lanes.js";
import { outlook } from "./calibration.js";
import { choices } from "./question.js";
import { room } from "./room.js";

const PAUSE_MS = 350;

export function widget(step) {
  const mover = room(step.setup);
  if (mover) replace(step.picture.below, mover);
  if (step.question.key === "wish") {
    outlook(step.setup).then(
      (drawn) => replace(step.setup.aside, drawn),
      () => {},
    );
    return choices(step, { several: true, draw: () => null });
  }
  const tried = h("div", { class: "stack setup-tried", "aria-live": "off" });
  tryIt(step, tried);
  return h("div", { class: "stack" }, sentence(step), tried);
}

/** The wish as a sentence with all its blanks in it, or a field for what is no part of one. */
function sentence(step) {
  const { question, setup } = step;
  const template = question.sentence;
  if (!template) {
    return h("label", { class: "field" }, h("span", { class: "sr" }, question.text), twin(step));
  }
  const wish = question.key.split("_")[0];
  const given = Object.fromEntries(setup.state.answers.map(({ key, answer }) => [key, answer]));
  const fields = {};
  const parts = template.split(/\{(\w+)\}/).map((part, index) => {
    if (index % 2 === 0) return part;
    const key = `${wish}_${part}`;
    if (key in given) return h("b", null, given[key]);
    const blank = question.blanks.find((each) => each.key === part);
    const input = h("input", {
      type: "text",
      class: "setup-blank",
      autocomplete: "off",
      value: key === question.key ? step.answer : blank.ready,
      "aria-label": blank.text,
      oninput: changed,
    });
    input.size = Math.max(6, input.value.length);
    if (key === question.key) input.dataset.first = "";
    fields[key] = input;
    return input;
  });
  step.more = () => Object.fromEntries(Object.entries(fields).map(([key, input]) => [key, input.value]));
  step.onAnswer((answer) => fields[question.key] !== document.activeElement && (fields[question.key].value = answer));
  return h("p", { class: "setup-sentence" }, parts);

  function changed() {
    step.set(fields[question.key].value);
    step.changed?.();
  }
}

function twin(step) {
  const input = h("input", {
    type: "text",
    autocomplete: "off",
    "data-first": "",
    oninput: () => step.set(input.value),
  });
  step.onAnswer((answer) => document.activeElement !== input && (input.value = answer));
  return input;
}

/** Draw what the wishes would do with the blanks as they are now. */
function tryIt(step, root) {
  const { setup, question, api } = step;
  let timer = 0;
  let asked = 0;
  const ask = async () => {
    const mine = ++asked;
    try {
      const { words, seen, made_up } = await api.post("setup/try", {
        answers: step.more?.() ?? { [question.key]: step.answer },
      });
      if (mine !== asked) return;
      root.classList.remove("is-old");
      const { unit } = setup.context;
      replace(
        root,
        words.map((each) => h("p", { class: "small" }, inCode(each))),
        seen && drawn("On the last minute", seen, unit),
        drawn("If it came, went, and was gone", made_up, unit),
      );
    } catch (error) {
      if (mine !== asked) return;
      root.classList.remove("is-old");
      replace(root, h("p", { class: "quiet small" }, error.message));
    }
  };
  step.changed = () => (clearTimeout(timer), root.classList.add("is-old"), (timer = setTimeout(ask, PAUSE_MS)));
  step.onAnswer(() => step.changed());
  setup.onLeave(() => ((asked += 1), clearTimeout(timer)));
}

/** What rules and outputs would do, in one run. */
function drawn(title, { seconds, rules, outputs, samples }, unit) {
  const alone = (name, spans) => ({ name, runs: [{ name: "", spans }] });
  const all = [
    ...rules.map(({ rule, active }) => alone(rule, active)),
    ...outputs.map(({ output, steps }) => alone(output, levels(steps, seconds))),
  ];
  return h(
    "section",
    null,
    h("b", null, title),
    lanes({ from_s: 0, to_s: seconds, samples, thresholds_m: [], lanes: all }, unit, { title }),
  );
}

/** Steps as spans; of a base, the larger of both speeds. */
const levels = (steps, seconds) =>
  steps
    .map(([at_s, first, second = 0], index) => ({
      from_s: at_s,
      to_s: steps[index + 1]?.[0] ?? seconds,
      level: Math.min(1, Math.max(Math.abs(first), Math.abs(second))),
    }))
    .filter((each) => each.level > 0);
