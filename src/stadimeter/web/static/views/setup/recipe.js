// What shall happen: recipes to choose from, and their blanks in a sentence.

import { h, replace } from "../../dom.js";
import { choices } from "./question.js";
import { room } from "./room.js";

export function widget(step) {
  const mover = room(step.setup);
  if (mover) replace(step.picture.below, mover);
  return step.question.key === "recipe" ? choices(step, { several: true, draw: () => null }) : sentence(step);
}

/** The recipe as a sentence with all its blanks in it, or a field for what is no part of one. */
function sentence(step) {
  const { question, setup } = step;
  const template = question.sentence;
  if (!template) {
    return h("label", { class: "field" }, h("span", { class: "sr" }, question.text), twin(step));
  }
  const recipe = question.key.split("_")[0];
  const given = Object.fromEntries(setup.state.answers.map(({ key, answer }) => [key, answer]));
  const fields = {};
  const parts = template.split(/\{(\w+)\}/).map((part, index) => {
    if (index % 2 === 0) return part;
    const key = `${recipe}_${part}`;
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
