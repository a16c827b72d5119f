// How the device is, in the run's own words; and what it sent to other programs.

import { h, keyed, write } from "../../dom.js";
import * as format from "../../format.js";

export function health() {
  const list = h("ul", { class: "list health" });
  const element = h("section", { class: "panel" }, h("h2", null, "Health"), list);
  return { element, update: ({ health: now }) => keyed(list, now.notes, (note) => note.what, () => note()) };
}

function note() {
  const mark = h("span", { class: "mark" });
  const what = h("strong");
  const words = h("span", { class: "number" });
  const element = h("li", { class: "note" }, mark, what, words);
  element.update = (each) => {
    mark.className = `mark is-${each.is_good ? "good" : "warning"}`;
    mark.title = each.is_good ? "good" : "look at this";
    write(what, each.what);
    write(words, each.words);
  };
  return element;
}

export function messages() {
  const list = h("ul", { class: "list small" });
  const element = h("section", { class: "panel" }, h("details", null, h("summary", null, h("h2", null, "Messages to other programs")), list));
  return {
    element,
    update({ messages: sent, now_s, unix_s }) {
      element.hidden = !sent?.length;
      keyed(list, sent ?? [], (each) => `${each.at_s} ${each.topic}`, (each) =>
        h("li", null, h("span", { class: "quiet number" }, format.moment(unix_s - now_s + each.at_s)), " ", h("strong", null, each.topic), " ", h("code", null, each.payload)));
    },
  };
}
