// An output: what it is, on which pin of the header, how it is wired; and a test of one that runs already.

import { h, replace } from "../../dom.js";
import { holdButton } from "../../hold_button.js";
import { choices } from "./form.js";

const PARTS = [
  ["buzzer", "Buzzer"],
  ["vibration-motor", "Vibration motor"],
  ["led", "LED"],
  ["relay", "Relay"],
];
const ON_PIN = /^([\w-]+) (\d+)$/;

export function widget(step) {
  const { setup, api } = step;
  const changed = () => step.set(`${part.value} ${pin.value}`);
  const part = h(
    "select",
    { onchange: changed },
    PARTS.map(([value, name]) => h("option", { value }, name)),
  );
  const pin = h("select", { onchange: changed });
  const said = h("p", { class: "small", role: "status" });
  const drawing = h("img", { class: "setup-circuit", alt: "" });
  const wired = h(
    "div",
    { class: "stack", hidden: true },
    h("label", { class: "field" }, h("span", null, "What is wired"), part),
    h("label", { class: "field" }, h("span", null, "The pin of its signal"), pin),
    said,
  );
  const notes = h("ul", { class: "setup-words" });
  const circuit = h(
    "section",
    { class: "panel stack setup-wiring", hidden: true },
    h("h2", null, "How it is wired"),
    h("div", { class: "setup-scrolls", tabindex: 0, role: "group", "aria-label": "Wiring" }, drawing),
    notes,
  );
  let asked = 0;
  replace(setup.aside, circuit);
  setup.onLeave(() => ((asked += 1), URL.revokeObjectURL(drawing.src)));
  step.onAnswer(async (answer) => {
    const [, driver, gpio] = ON_PIN.exec(answer) ?? [];
    wired.hidden = circuit.hidden = !driver;
    const mine = ++asked;
    if (!driver) return;
    try {
      const { blob, values } = await api.picture(`setup/wiring.svg?output=${encodeURIComponent(answer)}`);
      if (mine !== asked) return;
      URL.revokeObjectURL(drawing.src);
      drawing.src = URL.createObjectURL(blob);
      drawing.alt = `How the ${driver} is wired to GPIO ${gpio}`;
      part.value = driver;
      replace(pin, values.pins.map(pinOption));
      pin.value = gpio;
      replace(
        notes,
        values.notes.map((each) => h("li", null, each)),
      );
      const { warning } = values.pins.find((each) => String(each.gpio) === gpio) ?? {};
      replace(said, warning ? `Careful: it is used for ${warning}.` : "");
      said.classList.toggle("is-warning", Boolean(warning));
    } catch (error) {
      if (mine !== asked) return;
      circuit.hidden = true; // it is of the former one
      replace(said, error.message);
    }
  });
  return h("div", { class: "stack" }, choices(step), wired, held(step));
}

const pinOption = ({ number, gpio, taken_by, warning }) => {
  const note = taken_by.length ? `, taken by ${taken_by.join(", ")}` : warning ? `, used for ${warning}` : "";
  return h("option", { value: String(gpio) }, `GPIO ${gpio}, pin ${number}${note}`);
};

/** The outputs of a run that is there, each to be tried while a button is held. */
function held(step) {
  const { live, api } = step.setup.context;
  const root = h("div", { class: "stack" });
  const words = h("p", { class: "small", role: "status" });
  let shown = "";
  const undo = live.subscribe(
    (snapshot) => {
      const levels = snapshot.outputs.filter(({ kind }) => kind === "level").map(({ output }) => output);
      if (levels.join() === shown) return;
      shown = levels.join();
      for (const each of root.querySelectorAll("button")) each.takeDown?.();
      const buttons = levels.map((output) =>
        holdButton({
          label: `Hold to test ${output}`,
          held: `${output} is on`,
          send: async () => (await api.post(`outputs/${encodeURIComponent(output)}/hold`, { level: 1 }))?.reason ?? "",
          release: () => api.post(`outputs/${encodeURIComponent(output)}/hold`, { release: true }),
          onWords: (text) => replace(words, text),
        }),
      );
      replace(
        root,
        levels.length > 0 &&
          h(
            "p",
            { class: "quiet small" },
            "The run that is there now has these outputs. Each is on only while its button is held.",
          ),
        h("div", { class: "row" }, buttons),
        words,
      );
    },
    { image: false },
  );
  step.setup.onLeave(() => (undo(), root.querySelectorAll("button").forEach((each) => each.takeDown?.())));
  return root;
}
