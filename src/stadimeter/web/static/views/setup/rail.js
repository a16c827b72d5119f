// The way: what is answered, what is asked now, what is to come. An answer is a button that goes back to its question.

import { h } from "../../dom.js";

const STAGES = ["Camera", "Target", "Calibration", "What happens", "Outputs", "Save"];
const KNOWN = { camera: 0, calibration: 2 };

/** The stage of a question: what is asked before the calibration is about the target, whatever its kind asks. */
const stageOf = (key, isBeforeLens) => KNOWN[key] ?? (isBeforeLens ? 1 : /_output$|^base|^broker$/.test(key) ? 4 : 3);

export function drawRail(setup) {
  const { answers, done, question } = setup.state;
  const lensAt = answers.findIndex(({ key }) => key === "calibration");
  const now = done ? STAGES.length - 1 : stageOf(question.key, lensAt < 0);
  const given = answers.map((each, index) => ({
    ...each,
    back: answers.length - index,
    stage: stageOf(each.key, lensAt < 0 || index < lensAt),
  }));
  const stages = STAGES.map((name, index) => {
    const mine = given.filter((each) => each.stage === index);
    const status = index === now ? "now" : mine.length ? "done" : "to come";
    return h(
      "li",
      { class: `is-${status.replace(" ", "-")}`, "aria-current": index === now ? "step" : null },
      h(
        "span",
        { class: "setup-stage" },
        h("span", { class: "setup-dot", "aria-hidden": "true" }, status === "done" ? "✓" : index + 1),
        h("span", null, name),
        h("span", { class: "sr" }, `: ${status}`),
      ),
      mine.map((each) => answerButton(setup, each)),
    );
  });
  return h(
    "nav",
    { class: "setup-rail", "aria-label": "Steps of the set-up" },
    h("ol", null, stages),
    h("p", { class: "small" }, h("a", { href: "#certificate" }, "Certificate of the site")),
  );
}

const answerButton = (setup, { key, answer, back }) =>
  h(
    "button",
    {
      type: "button",
      class: "setup-given",
      title: answer,
      "aria-label": `Change the answer to ${key.replace("_", ", ")}: ${answer}`,
      onclick: () => setup.back(back),
    },
    inShort(answer),
  );

/** An answer as a person remembers it: of a picture that the set-up took itself, only how far away the target was. */
const inShort = (answer) => answer.replace(/^init\/[^@]*@([\d.]+) ?(\w+)$/, "at $1 $2");
