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
  const usual = step.question.options.find(({ answer }) => ON_PIN.test(answer));
  const [, usualPart, usualPin] = ON_PIN.exec(usual?.answer ?? "buzzer 23");
  let [part, pin] = [usualPart, Number(usualPin)];
  const kind = h(
    "select",
    { "aria-label": "What is wired", onchange: () => ((part = kind.value), chosen()) },
    PARTS.map(([value, name]) => h("option", { value }, name)),
  );
  const header = h("div", {
    class: "setup-header",
    role: "radiogroup",
    "aria-label": "Pins of the header of a Raspberry Pi",
  });
  const said = h("p", { class: "small", role: "status" });
  const drawing = h("img", {
    class: "setup-circuit",
    alt: "",
    onload: () => (wider.hidden = drawing.parentElement.scrollWidth <= drawing.parentElement.clientWidth),
  });
  const wider = h("p", { class: "quiet small", hidden: true }, "The drawing goes on to the right: move it sideways.");
  const wired = h(
    "div",
    { class: "stack", hidden: true },
    h("label", { class: "field" }, h("span", null, "What is wired"), kind),
    h("p", { class: "quiet small" }, "Choose the pin of its signal. The other wires are drawn."),
    h("div", { class: "setup-board" }, header),
    said,
  );
  let asked = 0;
  let url = "";
  const wires = h("p");
  const notes = h("ul", { class: "setup-words" });
  const circuit = h(
    "section",
    { class: "panel stack setup-wiring", hidden: true },
    h("h2", null, "How it is wired"),
    wires,
    h("div", { class: "setup-scrolls", tabindex: 0, role: "group", "aria-label": "Wiring" }, drawing),
    wider,
    notes,
  );
  replace(setup.aside, circuit);
  setup.onLeave(() => ((asked += 1), URL.revokeObjectURL(url)));
  step.onAnswer(async (answer) => {
    const found = ON_PIN.exec(answer);
    wired.hidden = circuit.hidden = !found;
    if (!found) return;
    [part, pin] = [found[1], Number(found[2])];
    kind.value = part;
    const mine = ++asked;
    try {
      const { blob, values } = await api.picture(`setup/wiring.svg?output=${encodeURIComponent(answer)}`);
      if (mine !== asked) return;
      URL.revokeObjectURL(url);
      drawing.src = url = URL.createObjectURL(blob);
      replace(
        wires,
        `Wires to the header: ${values.wires.map(({ number, name }) => `pin ${number} (${name})`).join(", ")}.`,
      );
      replace(
        notes,
        values.notes.map((each) => h("li", null, each)),
      );
      drawing.alt = `How the ${part} is wired to GPIO ${pin}`;
      drawHeader(header, values.pins, pin, (gpio) => ((pin = gpio), chosen()));
      const mineNow = values.pins.find(({ gpio }) => gpio === pin);
      const careful = mineNow?.warning ? `Careful: it is used for ${mineNow.warning}.` : "";
      replace(said, mineNow ? `GPIO ${pin} is pin ${mineNow.number}. ${careful}` : "");
      said.classList.toggle("is-warning", Boolean(mineNow?.warning));
    } catch (error) {
      if (mine !== asked) return;
      circuit.hidden = true; // it is of the former one
      replace(said, error.message);
    }
  });
  return h("div", { class: "stack" }, choices(step), wired, held(step));

  function chosen() {
    step.set(`${part} ${pin}`);
  }
}

/** The 40 pins as they are on the board: odd ones left, even ones right. */
function drawHeader(root, pins, chosen, choose) {
  const isFocused = root.contains(document.activeElement);
  const gpios = pins.filter(({ gpio }) => gpio !== null);
  const button = ({ number, name, gpio, taken_by, warning }) => {
    const others = gpio === null || gpio === chosen ? [] : taken_by;
    const note = others.length ? `taken by ${others.join(", ")}` : warning;
    const what =
      gpio === null ? (name === "ground" ? "ground" : "power") : others.length ? "taken" : warning ? "careful" : "free";
    const props = { class: `setup-pin is-${what}${taken_by.length ? " is-wired" : ""}`, title: note };
    const inner = [
      h("span", { class: "setup-pin-number" }, number),
      h("span", null, gpio === null ? name : `GPIO ${gpio}`),
      note && h("span", { "aria-hidden": "true" }, "!"),
    ];
    if (gpio === null) return h("span", props, inner);
    return h(
      "button",
      {
        ...props,
        type: "button",
        role: "radio",
        "aria-checked": String(gpio === chosen),
        "aria-label": `Pin ${number}, GPIO ${gpio}${note ? `, ${note}` : ""}`,
        tabindex: gpio === chosen ? 0 : -1,
        dataset: { gpio },
        onclick: () => choose(gpio),
      },
      inner,
    );
  };
  replace(root, pins.map(button));
  root.onkeydown = (event) => {
    const step = { ArrowUp: -2, ArrowDown: 2, ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step) return;
    event.preventDefault();
    let at = pins.findIndex(({ gpio }) => gpio === chosen) + step;
    while (pins[at] && !gpios.includes(pins[at])) at += step;
    if (pins[at]) choose(pins[at].gpio);
  };
  if (isFocused) root.querySelector("[aria-checked=true]")?.focus();
}

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
