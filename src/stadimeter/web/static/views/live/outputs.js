// Each output as a meter: what it does, who commands it, and a test that lasts while a button is held.

import { h, keyed, write } from "../../dom.js";
import * as format from "../../format.js";
import { holdButton } from "../../hold_button.js";

const MOVES = [
  ["forwards", 1, 0],
  ["backwards", -1, 0],
  ["turn left", 0, 1],
  ["turn right", 0, -1],
];
const SLOW = { mps: 0.1, radps: 0.3 };

export function outputs(context) {
  const list = h("ul", { class: "list" });
  const none = h("p", { class: "quiet", hidden: true }, "No output.");
  const element = h("section", { class: "panel outputs" }, h("h2", null, "Outputs"), none, list);
  return {
    element,
    update(snapshot) {
      none.hidden = snapshot.outputs.length > 0;
      keyed(
        list,
        snapshot.outputs,
        (output) => output.output,
        (output) => card(output, context),
      );
    },
    takeDown: () => element.querySelectorAll(".hold").forEach((button) => button.takeDown()),
  };
}

function card({ output: name, kind }, context) {
  const meters = kind === "level" ? [meter("level", name)] : [meter("speed", name), meter("turn", name)];
  const who = h("p", { class: "small quiet" });
  const fault = h("p", { class: "small fault", hidden: true });
  const element = h(
    "li",
    { class: "output" },
    h("h3", null, name),
    meters.map((each) => each.element),
    who,
    fault,
    context.session.right === "operate" && test(name, kind, context),
  );
  element.update = (output) => {
    if (kind === "level") meters[0].show(output.level ?? 0, format.level(output.level ?? 0));
    else {
      meters[0].show(
        (output.linear_mps ?? 0) / (output.max_linear_mps || 1),
        format.speed(output.linear_mps ?? 0, context.unit),
      );
      meters[1].show(
        -(output.angular_radps ?? 0) / (output.max_angular_radps || 1),
        `${(output.angular_radps ?? 0).toFixed(2)} rad/s`,
      );
    }
    write(who, whoCommands(output, context.unit));
    write(fault, output.fault ? `Out of order: ${output.fault}` : "");
    fault.hidden = !output.fault;
  };
  return element;
}

function whoCommands({ winner, losers, reason, held_by }, unit) {
  const who = held_by ? `held by ${held_by}` : winner === "safe" ? "at its safe value" : `by ${winner}`;
  return `${who}${losers.length ? ` over ${losers.join(", ")}` : ""}${reason ? `: ${format.words(reason, unit)}` : ""}`;
}

/** A bar from its left end, or from its middle for what has two directions: right of it is forwards, or right. */
function meter(what, name) {
  const bar = h("span", { class: "bar" });
  const text = h("output", { class: "number" });
  const element = h(
    "div",
    { class: "metered" },
    h(
      "div",
      {
        class: `meter ${what === "level" ? "" : "two-sided"}`,
        role: "meter",
        "aria-label": `${name}: ${what}`,
        "aria-valuemin": what === "level" ? "0" : "-100",
        "aria-valuemax": "100",
      },
      bar,
    ),
    text,
  );
  return {
    element,
    show(part, words) {
      const shown = Math.max(-1, Math.min(1, part)) * 100;
      const [from, width] = what === "level" ? [0, shown] : [shown < 0 ? 50 + shown / 2 : 50, Math.abs(shown) / 2];
      bar.style.setProperty("left", `${from}%`);
      bar.style.setProperty("width", `${width}%`);
      element.firstChild.setAttribute("aria-valuenow", Math.round(shown));
      element.firstChild.setAttribute("aria-valuetext", words);
      write(text, words);
    },
  };
}

function test(name, kind, { api }) {
  const said = h("p", { class: "small", role: "status" });
  const path = `outputs/${encodeURIComponent(name)}/hold`;
  const held = (label, wish) =>
    holdButton({
      label,
      title: "Held only while you press",
      send: async () => (await api.post(path, { ...wish(), by: localStorage.getItem("name") || "page" }))?.words ?? "",
      release: () => api.post(path, { release: true }, { keepalive: true }),
      onWords: (words) => write(said, words),
    });
  let controls;
  if (kind === "level") {
    const level = h("input", {
      type: "range",
      min: 0,
      max: 100,
      value: 50,
      "aria-label": `${name}: level of the test, in per cent`,
    });
    controls = [level, held("Hold to test", () => ({ level: level.value / 100 }))];
  } else
    controls = MOVES.map(([label, along, round]) =>
      held(label, () => ({ linear_mps: along * SLOW.mps, angular_radps: round * SLOW.radps })),
    );
  const box = h(
    "details",
    { class: "test" },
    h("summary", null, "Test it"),
    h(
      "p",
      { class: "small quiet" },
      kind === "level"
        ? "It is on only while you hold the button."
        : "It moves slowly, only while you hold a button. Make room first.",
    ),
    h("div", { class: "row" }, controls),
    said,
  );
  return box;
}
