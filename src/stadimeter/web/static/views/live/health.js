// How the device is, in the run's own words; and what it sent to other programs.

import { h, keyed, write } from "../../dom.js";
import * as format from "../../format.js";

export function health() {
  const list = h("ul", { class: "list health" });
  const element = h("section", { class: "panel" }, h("h2", null, "Health"), list);
  return {
    element,
    update: ({ health: now }) =>
      keyed(
        list,
        now.notes,
        (note) => note.what,
        () => note(),
      ),
  };
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
  const facts = h("ul", { class: "list health" });
  const topics = h("ul", { class: "list small" });
  const newest = h("ul", { class: "list small" });
  const folded = (words, list) => h("details", null, h("summary", null, words), list);
  const element = h(
    "section",
    { class: "panel" },
    h("h2", null, "Messages to other programs"),
    facts,
    folded("Topics, each with its newest message", topics),
    folded("The newest messages", newest),
  );
  return {
    element,
    update({ messenger: link, messages: sent, now_s, unix_s }) {
      element.hidden = !link;
      if (!link) return;
      keyed(
        facts,
        linkNotes(link),
        (each) => each.what,
        () => note(),
      );
      const age = (each) => `${Math.max(0, now_s - each.at_s).toFixed(0)} s ago`;
      keyed(
        topics,
        [...link.topics].sort((one, other) => (one.topic < other.topic ? -1 : 1)),
        (each) => each.topic,
        () => said(age),
      );
      keyed(
        newest,
        sent,
        (each) => `${each.at_s} ${each.topic}`,
        () => said((each) => format.moment(unix_s - now_s + each.at_s)),
      );
    },
  };
}

const MAY = { off: "none is taken", alarms: "alarms, and stopping outputs", all: "all" };

function linkNotes(link) {
  const lost = link.given_up + link.dropped;
  return [
    {
      what: "broker",
      words: `${link.broker} ${link.trouble ? `: ${link.trouble}` : "connected"}`.trim(),
      is_good: !link.trouble,
    },
    { what: "base topic", words: link.base, is_good: true },
    {
      what: "not delivered",
      words: `${link.undelivered} waiting, ${link.given_up} given up, ${link.dropped} dropped`,
      is_good: !lost,
    },
    { what: "commands", words: link.deafness || `${link.commands}: ${MAY[link.commands]}`, is_good: !link.deafness },
    {
      what: "Home Assistant",
      words: link.home_assistant ? `discovers it by ${link.home_assistant}` : "is not told of it",
      is_good: true,
    },
  ];
}

function said(when) {
  const [moment, topic, payload] = [h("span", { class: "quiet number" }), h("strong"), h("code")];
  const element = h("li", null, moment, " ", topic, " ", payload);
  element.update = (each) => {
    write(moment, when(each));
    write(topic, each.topic);
    write(payload, each.payload);
  };
  return element;
}
