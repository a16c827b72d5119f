// The way: what is answered, what is asked now, what is to come. An answer is a button that goes back to its question.

import { html } from "../../ui.js";

const STAGES = ["Camera", "Target", "Calibration", "What happens", "Outputs", "Save"];
const KNOWN = { camera: 0, calibration: 2 };

/** The stage of a question: what is asked before the calibration is about the target, whatever its kind asks. */
const stageOf = (key, isBeforeLens) => KNOWN[key] ?? (isBeforeLens ? 1 : /_output$|^base|^broker$/.test(key) ? 4 : 3);

export function Rail({ setup }) {
  const { answers, done, question } = setup.state;
  const lensAt = answers.findIndex(({ key }) => key === "calibration");
  const now = done ? STAGES.length - 1 : stageOf(question.key, lensAt < 0);
  const given = answers.map((each, index) => ({
    ...each,
    goBack: () => setup.back(answers.length - index),
    stage: stageOf(each.key, lensAt < 0 || index < lensAt),
  }));
  const stage = (name, index) => {
    const mine = given.filter((each) => each.stage === index);
    const status = index === now ? "now" : mine.length ? "done" : "to come";
    return html`<li class=${`is-${status.replace(" ", "-")}`} aria-current=${index === now ? "step" : undefined}>
      <span class="setup-stage">
        <span class="setup-dot" aria-hidden="true">${status === "done" ? "✓" : index + 1}</span>
        <span>${name}</span><span class="sr">: ${status}</span></span>
      ${mine.map((each) => html`<${Given} key=${each.key} name=${each.key} ...${each} />`)}
    </li>`;
  };
  return html`<nav class="setup-rail" aria-label="Steps of the set-up"><ol>${STAGES.map(stage)}</ol></nav>`;
}

const Given = ({ name, answer, goBack }) => html`<button type="button" class="setup-given" title=${answer}
  aria-label=${`Change the answer to ${name.replace("_", ", ")}: ${answer}`} onclick=${goBack}>${inShort(answer)}</button>`;

/** An answer as a person remembers it: of a picture that the set-up took itself, only how far away the target was. */
const inShort = (answer) => answer.replace(/^init\/[^@]*@([\d.]+) ?(\w+)$/, "at $1 $2");
