// The lens: the target at a distance that is known; or a camera file, or a guess.

import { h } from "../../dom.js";
import { choices } from "./form.js";

const LIVE = /^[\d.]+ m$/;

export function widget(step) {
  const { question, setup } = step;
  const live = question.options.find(({ answer }) => LIVE.test(answer));
  if (!live) return choices(step);
  const ways = question.options.filter((each) => each !== live);
  const other = ({ answer, meaning }) =>
    h(
      "button",
      { type: "button", class: "button setup-way-other", onclick: () => step.submit(answer) },
      h("b", null, answer),
      h("span", { class: "quiet small" }, meaning),
    );
  const value = setup.state.doubt ? live.answer : question.ready;
  const input = h("input", { type: "text", autocomplete: "off", value, "data-first": "" });
  input.addEventListener("input", () => step.set(input.value));
  step.busyWords = "Taking pictures: hold still …";
  step.goes = "Take it";
  step.below = h(
    "details",
    null,
    h("summary", null, "Another way"),
    h("div", { class: "row setup-group" }, ways.map(other)),
  );
  const words = "It is this far from the lens now; with ± how well you know it, such as 1 m ± 5 mm";
  return h("label", { class: "field" }, h("span", null, words), input);
}
