// What happened, newest first.

import { h, keyed } from "../../dom.js";
import * as format from "../../format.js";

export const SEVERITIES = ["info", "warning", "alarm", "safety"];
const LOOKS = { info: "quiet", warning: "warning", alarm: "alarm", safety: "alarm" };

export function eventList({ live, unit }, most) {
  const list = h("ol", { class: "list events" });
  const none = h("p", { class: "quiet", hidden: true }, "Nothing has happened yet.");
  const element = h(
    "section",
    { class: "panel happened" },
    h("h2", null, "Events"),
    none,
    list,
    h("p", null, h("a", { href: "#alarms" }, "All alarms and events")),
  );
  return {
    element,
    update() {
      none.hidden = live.history.events.length > 0;
      drawEvents(list, live.history.events.slice(0, most), unit);
    },
  };
}

/** Put events into a list, each as when, what to whom, why and who, and its clip where `clipOf` knows one. */
export function drawEvents(list, events, unit, clipOf = () => "") {
  keyed(
    list,
    events,
    (event) => event.number,
    (event) => {
      const clip = h("a", { class: "small" }, "Watch the clip");
      const update = ({ unix_s }) => Object.assign(clip, { href: clipOf(unix_s), hidden: !clipOf(unix_s) });
      const element = h(
        "li",
        { class: "event" },
        h("span", { class: `mark is-${LOOKS[event.severity]}`, title: event.severity }),
        h("strong", null, `${event.source} ${event.kind.replaceAll("_", " ")}`, event.by && ` by ${event.by}`),
        h("time", { class: "number quiet small" }, format.moment(event.unix_s)),
        why(event) && h("span", { class: "reason small" }, format.words(why(event), unit)),
        clip,
        h("span", { class: "sr" }, `(${event.severity})`),
      );
      return Object.assign(element, { update });
    },
  );
}

/** Why it happened, without who did it: that is said above it. */
const why = ({ reason, by }) =>
  by && reason?.startsWith(`by ${by}`) ? reason.slice(3 + by.length).replace(/^: /, "") : reason;
