// A question as a form: what was found, what its kind needs, the answer as text, and the way on and back.

import { Button, Field, html, inCode, Model, useModel, useRef } from "../../ui.js";

/** The form of the question that is asked. A kind of question has a `Widget` of its `step`, which stands above the answer
 *  as text, and `wayOf(step)`: `{goes, busy, Below}`, the words of the way on, and what stands below it. */
export function Form({ setup, kind: { Widget = Choices, draw, wayOf = (_step) => ({}) } }) {
  const { question, doubt, answers } = setup.state;
  const step = useModel(Step, { setup, question, answer: question.ready });
  const { goes = "Go on", busy = "One moment …", Below } = wayOf(step);
  const way = step.isDoubted ? "Use it all the same" : goes;
  const isInWords = Widget === Choices && !question.options.length;
  const submit = (event) => (event.preventDefault(), step.send());
  const enter = (event) => event.key === "Enter" && event.target.tagName === "SELECT" && submit(event);
  const found = html`${!draw && question.found.map((line) => html`<${Found} line=${line} />`)}`;
  const others = html`<details class="setup-text" open=${isInWords}>
    <summary>${isInWords ? "Your answer" : "Answer in words instead"}</summary>
    <label class="field"><span class="sr">${question.text}</span>
      <input type="text" autocomplete="off" spellcheck=${false} list=${namesOf(question)} data-first=""
        aria-invalid=${step.error ? "true" : undefined} value=${step.answer}
        oninput=${(event) => step.set(event.target.value)} />
      <${Names} of=${question} />
      ${question.form && html`<span class="quiet small">${question.form}</span>`}</label></details>`;
  return html`<form class="panel stack" novalidate onsubmit=${submit} onkeydown=${enter}>
    ${!Below && found}
    <${Widget} step=${step} />
    ${!Below && others}
    ${step.isDoubted && html`<${Doubt} ...${doubt} />`}
    <p class="setup-error" role="alert" hidden=${!step.error}>${step.error}</p>
    <progress hidden=${!step.isSending && !step.isWaiting} aria-label="Working" />
    <div class="row setup-way">
      ${answers.length > 0 && html`<${Button} onclick=${() => setup.back()}>Back<//>`}
      <button class="button primary" disabled=${step.isSending}>${step.isSending ? busy : way}</button></div>
    ${Below && html`<${Below} step=${step} />${found}${others}`}
  </form>`;
}

const Doubt = ({ notes }) => html`<div class="setup-doubt" role="alert">
  ${notes.map((each) => html`<p>${inCode(each)}</p>`)}<p>Change the answer, or go on with it as it is.</p></div>`;

const Found = ({ line }) => html`<p class="quiet">${inCode(line)}</p>`;

/** The answer as it is now, and what became of it. */
class Step extends Model {
  error = "";
  isSending = false;
  isWaiting = false; // a widget is
  blanks = {}; // of options that leave something open: what was typed, by key

  get isDoubted() {
    return Boolean(this.setup.state.doubt) && this.answer === this.question.ready;
  }

  /** The options that are chosen: where it is asked for recipes, there may be several. */
  get chosen() {
    const answers = this.hasSeveral ? this.answer.split(/[\s,]+/) : [this.answer];
    return this.question.options.filter(({ answer }) => answers.includes(answer));
  }

  get hasSeveral() {
    return this.question.key === "recipe";
  }

  set(answer) {
    if (answer !== this.answer) this.put({ answer, error: "" });
  }

  say(words) {
    this.put({ error: words && words[0].toUpperCase() + words.slice(1) });
  }

  async send(answer = this.answer) {
    if (this.isSending) return;
    this.put({ answer, error: "", isSending: true });
    const blanks = this.chosen.flatMap((each) => each.blanks);
    try {
      await this.setup.answer(
        answer,
        Object.fromEntries(blanks.map(({ key, ready }) => [key, this.blanks[key] ?? ready])),
      );
    } catch (error) {
      this.say(error.message);
    }
    this.put({ isSending: false });
  }
}

/** The answers that are suggested, as cards, with fields for what the chosen ones leave open; nothing where none are.
 *  `draw(option)` returns what a card shows more. Those of one group are folded away together, but for the first group
 *  and what is chosen. */
export function Choices({ step, draw = drawn }) {
  const { hasSeveral, chosen, question } = step;
  const { options, key, text } = question;
  const ready = useRef(new Set(chosen.map(({ group }) => group)));
  if (!options.length) return null;
  const isChosen = (option) => chosen.includes(option);
  const first = chosen[0] ?? options[0];
  const choose = (option) => {
    const others = options.filter((each) => (each === option) !== isChosen(each));
    step.set(hasSeveral ? others.map(({ answer }) => answer).join(" ") : option.answer);
  };
  const card = (option) => {
    const [name, words] = option.group ? [option.meaning, option.answer] : [option.answer, option.meaning];
    return html`<label class="setup-card">
        <input type=${hasSeveral ? "checkbox" : "radio"} name=${key} value=${option.answer} checked=${isChosen(option)}
          data-first=${option === first ? "" : undefined} onchange=${() => choose(option)} />
        ${draw(option)}
        <span class="setup-card-words"><b>${inCode(name)}</b>${" "}<span class="quiet">${inCode(words)}</span></span></label>
      ${
        isChosen(option) &&
        option.blanks.length > 0 &&
        html`<div class="stack setup-open">
          ${option.blanks.map((blank) => html`<${Blank} key=${blank.key} ...${blank} name=${blank.key} step=${step} />`)}</div>`
      }`;
  };
  const group = (name, index) => {
    const members = options.filter((each) => each.group === name);
    if (!name) return members.map(card);
    const count = members.filter(isChosen).length;
    return html`<details class="setup-group" open=${index === 0 || ready.current.has(name)}>
      <summary>${name}${" "}${count > 0 && html`<span class="badge is-good">${count} chosen</span>`}</summary>
      ${members.map(card)}</details>`;
  };
  return html`<fieldset class="setup-cards"><legend class="sr">${text}</legend>
    ${[...new Set(options.map((each) => each.group))].map(group)}</fieldset>`;
}

const drawn = ({ picture }) =>
  picture && html`<svg viewBox="0 0 80 60" class="setup-drawn" aria-hidden="true"><path d=${picture} /></svg>`;

/** A field for a blank, as its description has it: what it asks, the ready answer, names to choose from, its form. */
function Blank({ name, text, ready, form, found, names, options, step }) {
  const known = { key: name, names: [...names, ...options.map(({ answer }) => answer)] };
  return html`<${Field} label=${inCode(text)}>
    <input type="text" autocomplete="off" spellcheck=${false} list=${namesOf(known)} defaultValue=${ready}
      oninput=${(event) => (step.blanks[name] = event.target.value)} />
    <${Names} of=${known} />
    <span class="quiet small">${inCode([form, ...found].filter(Boolean).join(". "))}</span><//>`;
}

const namesOf = ({ key, names }) => (names.length ? `names-of-${key}` : undefined);

const Names = ({ of }) =>
  of.names.length > 0 &&
  html`<datalist id=${namesOf(of)}>${of.names.map((each) => html`<option value=${each} />`)}</datalist>`;
