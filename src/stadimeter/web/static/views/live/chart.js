// The distances of the last minutes: the chart of the timeline, which can only be read here.

import { h, write } from "../../dom.js";
import * as format from "../../format.js";
import { TimelineChart } from "../timeline/chart.js";
import { dataOf, readAt } from "../timeline/data.js";

const WINDOWS = [
  [30, "30 s"],
  [60, "1 min"],
  [300, "5 min"],
];
const STEPS = 300;
const HEIGHT = 180;
const SHOWN_EVENTS = new Set(["raised", "cleared", "acknowledged", "reset", "fault", "target_lost"]);
const NAME = "Distances of the last minutes: arrow keys read them";

export function chart({ live, unit }) {
  const read = h("p", { class: "small number read", role: "status" });
  const wanted = h(
    "select",
    { "aria-label": "How much of the past", onchange: () => localStorage.setItem("window", wanted.value) },
    WINDOWS.map(([value, text]) =>
      h("option", { value, selected: localStorage.getItem("window") === String(value) }, text),
    ),
  );
  let data = null;
  const onread = (unix_s) => {
    const names = Object.keys(data?.targets ?? {});
    const all = names.length > 1 ? `${names.join(", ")}. ` : "";
    if (unix_s === null) write(read, `${all}Point at the chart, or use its arrow keys, to read it.`);
    else write(read, `${format.since(live.snapshot.unix_s - unix_s)} · ${readAt(data, unix_s, unit)}`);
    return read.textContent;
  };
  const plot = new TimelineChart({ unit, onread, label: NAME, height: HEIGHT });
  const head = h("div", { class: "row head" }, h("h2", null, "Distance"), wanted);
  return {
    element: h("section", { class: "panel chart" }, head, plot.element, read),
    update({ unix_s, targets }) {
      const [span_s, step_s] = [Number(wanted.value), wanted.value / STEPS];
      const from_s = unix_s - span_s;
      const none = { from_s, step_s, count: STEPS, targets: {}, lanes: [], events: [] };
      const { events, ...shown } = dataOf(none, live);
      data = { ...shown, lanes: [], clips: [], events: events.filter(({ kind }) => SHOWN_EVENTS.has(kind)) };
      const limits_m = new Set(targets.flatMap(({ thresholds_m }) => thresholds_m));
      plot.thresholds = [...limits_m].map((value_m) => ({ rule: "", value_m }));
      plot.setView(from_s, unix_s);
      plot.setData(data);
    },
    takeDown: () => plot.takeDown(),
  };
}
