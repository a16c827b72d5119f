// A question as a form: what was found, what its kind needs, the answer as text, and the way on and back.

import { h, inCode, replace, svg } from "../../dom.js";

/** The form of the question that is asked. A step's `widget(step)` returns what stands above the answer as text.
 *  The text field holds the answer: a widget sets it by `step.set(answer)`, and hears of it by `step.onAnswer(fn)`. */
export function answerForm(setup, widget = choices) {
  const { question, doubt, answers } = setup.state;
  const step = new Step(setup, question);
  const shown = widget(step);
  step.isBusy(false);
  const doubted =
    doubt &&
    h(
      "div",
      { class: "setup-doubt", role: "alert" },
      doubt.notes.map((each) => h("p", null, inCode(each))),
      h("p", null, "Change the answer, or go on with it as it is."),
    );
  if (doubted) step.onAnswer((answer) => (doubted.hidden = answer !== question.ready)); // it is about that answer alone
  const others = h(
    "details",
    { class: "setup-text", open: !shown },
    h("summary", null, shown ? "Answer in words instead" : "Your answer"),
    h(
      "label",
      { class: "field" },
      h("span", { class: "sr" }, question.text),
      step.text,
      question.names.length > 0 && namesList(question.key, question.names),
      question.form && h("span", { class: "quiet small" }, question.form),
    ),
  );
  const found = !step.picture.isSaid && question.found.map(told);
  const send = async (event) => {
    event.preventDefault();
    if (step.go.disabled) return; // it is on its way
    step.isBusy(true);
    try {
      await setup.answer(step.answer, step.more?.());
    } catch (error) {
      step.say(error.message);
      step.text.setAttribute("aria-invalid", "true");
    }
    step.isBusy(false);
  };
  const enter = (event) =>
    event.key === "Enter" && event.target.tagName === "SELECT" && (event.preventDefault(), form.requestSubmit());
  step.submit = (answer) => (step.set(answer), form.requestSubmit());
  const form = h(
    "form",
    { class: "panel stack", onsubmit: send, onkeydown: enter, novalidate: true },
    !step.below && found,
    shown,
    !step.below && others,
    doubted,
    step.error,
    step.progress,
    h(
      "div",
      { class: "row setup-way" },
      answers.length > 0 && h("button", { type: "button", class: "button", onclick: () => setup.back() }, "Back"),
      step.go,
    ),
    step.below,
    step.below && [found, others],
  );
  return form;
}

/** What was found, in words. A drawing of a distance is in letters of one width, and what it is stands beside it. */
function told(line) {
  const [, drawn, words] = /^(lens \|.*?) {3,}(.*)$/.exec(line) ?? [];
  return drawn
    ? h("p", { class: "row small" }, h("code", { class: "setup-drawing" }, drawn), h("span", null, words))
    : h("p", { class: "quiet" }, inCode(line));
}

class Step {
  #listeners = [];
  below = null; // what stands below the way on

  constructor(setup, question) {
    Object.assign(this, {
      setup,
      question,
      api: setup.api,
      picture: setup.picture,
      goes: "Go on",
      busyWords: "One moment …",
    });
    this.text = h("input", {
      type: "text",
      value: question.ready,
      autocomplete: "off",
      spellcheck: false,
      list: question.names.length > 0 ? `names-of-${question.key}` : null,
      "data-first": "",
      oninput: () => this.#tell(),
    });
    this.error = h("p", { class: "setup-error", role: "alert", hidden: true });
    this.go = h("button", { type: "submit", class: "button primary" });
    this.progress = h("progress", { hidden: true, "aria-label": "Working" });
    this.isBusy(false);
  }

  get answer() {
    return this.text.value;
  }

  set(answer) {
    if (answer === this.text.value) return;
    this.text.value = answer;
    this.#tell();
  }

  onAnswer(fn) {
    this.#listeners.push(fn);
    fn(this.answer);
  }

  say(words) {
    this.error.hidden = !words;
    replace(this.error, words && words[0].toUpperCase() + words.slice(1));
  }

  isBusy(isIt) {
    this.go.disabled = isIt;
    replace(this.go, isIt ? this.busyWords : this.#goes());
    this.progress.hidden = !isIt;
  }

  #goes() {
    return this.setup.state.doubt && this.answer === this.question.ready ? "Use it all the same" : this.goes;
  }

  #tell() {
    this.say("");
    this.text.removeAttribute("aria-invalid");
    replace(this.go, this.#goes());
    for (const fn of this.#listeners) fn(this.answer);
  }
}

/** The answers that are suggested, as cards, with fields for what the chosen ones leave open; nothing where none are.
 *  `draw(option)` returns what a card shows more. Those of one group are folded away together, but for the first group
 *  and what is chosen. */
export function choices(step, { draw = drawn } = {}) {
  const { options, key, text } = step.question;
  if (!options.length) return null;
  const several = key === "recipe";
  const opens = []; // the blanks of each option
  const inputs = options.map((option) =>
    h("input", { type: several ? "checkbox" : "radio", name: key, value: option.answer, onchange: chosen }),
  );
  const groups = [...new Set(options.map(({ group }) => group))].map((name, index) => {
    const members = inputs.filter((_, at) => options[at].group === name);
    const count = h("span", { class: "badge is-good" });
    const cards = h("div", { class: "setup-cards" }, members.map(card));
    const summary = h("summary", null, name, " ", count);
    const element = name ? h("details", { class: "setup-group", open: index === 0 }, summary, cards) : cards;
    return { members, count, element };
  });
  function chosen() {
    step.set(
      inputs
        .filter((each) => each.checked)
        .map((each) => each.value)
        .join(" "),
    );
  }
  function card(input) {
    const option = options[inputs.indexOf(input)];
    const [first, second] = option.group ? [option.meaning, option.answer] : [option.answer, option.meaning];
    const words = [h("b", null, inCode(first)), " ", h("span", { class: "quiet" }, inCode(second))];
    const label = h(
      "label",
      { class: "setup-card" },
      input,
      draw(option),
      h("span", { class: "setup-card-words" }, words),
    );
    return [label, option.blanks.length > 0 && openOf(input, option)];
  }
  function openOf(input, { blanks }) {
    const fields = blanks.map(blankField);
    const open = h(
      "div",
      { class: "stack setup-open" },
      fields.map(({ element }) => element),
    );
    const values = () => Object.fromEntries(blanks.map(({ key }, at) => [key, fields[at].input.value]));
    opens.push({ input, open, values });
    return open;
  }
  step.onAnswer((answer) => {
    const words = several ? answer.split(/[\s,]+/) : [answer];
    for (const each of inputs) each.checked = words.includes(each.value);
    for (const { members, count, element } of groups) {
      const mine = members.filter((each) => each.checked).length;
      count.hidden = !mine;
      replace(count, `${mine} chosen`);
      if (mine) element.open = true;
    }
    for (const { input, open } of opens) open.hidden = !input.checked;
  });
  step.more = () => Object.assign({}, ...opens.filter(({ input }) => input.checked).map(({ values }) => values()));
  (inputs.find((each) => each.checked) ?? inputs[0]).dataset.first = "";
  const legend = h("legend", { class: "sr" }, text);
  return h(
    "fieldset",
    { class: "setup-cards" },
    legend,
    groups.map(({ element }) => element),
  );
}

const drawn = ({ picture }) =>
  picture &&
  svg("svg", { viewBox: "0 0 80 60", class: "setup-drawn", "aria-hidden": "true" }, svg("path", { d: picture }));

/** A field for a blank, as its description has it: what it asks, the ready answer, names to choose from, its form. */
function blankField({ key, text, ready, form, found, names, options }) {
  const known = [...names, ...options.map(({ answer }) => answer)];
  const list = known.length > 0 && namesList(key, known);
  const props = { type: "text", value: ready, autocomplete: "off", spellcheck: false, list: list ? list.id : null };
  const input = h("input", props);
  const words = h("span", { class: "quiet small" }, inCode([form, ...found].filter(Boolean).join(". ")));
  return { input, element: h("label", { class: "field" }, h("span", null, inCode(text)), input, list, words) };
}

const namesList = (key, names) =>
  h(
    "datalist",
    { id: `names-of-${key}` },
    names.map((value) => h("option", { value })),
  );
