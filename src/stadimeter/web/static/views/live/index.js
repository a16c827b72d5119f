// The live page: what the camera sees, what is measured, what the rules do about it, and how all of it is.

import { h, replace } from "../../dom.js";
import { chart } from "./chart.js";
import { eventList } from "./events.js";
import { health, messages } from "./health.js";
import { outputs } from "./outputs.js";
import { picture } from "./picture.js";
import { room } from "./room.js";
import { rules } from "./rules.js";
import { remembered, targets } from "./targets.js";

const SLOW_MS = 200; // words and lines need not change as often as the picture

export function mount(root, context) {
  const quick = [picture(context), targets(context)];
  const slow = [
    rules(context),
    outputs(context),
    chart(context),
    eventList(context, 5),
    health(context),
    room(context),
    messages(context),
    remembered(context),
  ];
  const [shown, figures] = quick;
  const [ofRules, ofOutputs, ofChart, ofEvents, ofHealth, ofRoom, ofMessages, ofFigures] = slow;
  const column = (name, ...parts) =>
    h(
      "div",
      { class: `stack ${name}` },
      parts.map((part) => part.element),
    );
  replace(
    root,
    h("h1", { class: "sr" }, "Live"),
    h(
      "div",
      { class: "live" },
      column("seen", shown, shown.tools, ofChart, ofEvents),
      column("done", figures, ofRules, ofFigures, ofOutputs),
      column("told", ofRoom, ofHealth, ofMessages),
    ),
  );
  let last = 0;
  const leave = context.live.subscribe((snapshot, bitmap) => {
    for (const part of quick) part.update(snapshot, bitmap);
    if (performance.now() - last < SLOW_MS) return;
    last = performance.now();
    for (const part of slow) part.update(snapshot);
  });
  return () => {
    leave();
    for (const part of [...quick, ...slow]) part.takeDown?.();
  };
}
