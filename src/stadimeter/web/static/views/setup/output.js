// An output: what it is, on which pin of the header, how it is wired; and a test of one that runs already.

import { api } from "../../api.js";
import { HoldButton } from "../../hold_button.js";
import { latest } from "../../latest.js";
import { Field, html, Photo, Select, useEffect, useRef, useSnapshot, useState } from "../../ui.js";
import { Choices } from "./form.js";

const PARTS = { buzzer: "Buzzer", "vibration-motor": "Vibration motor", led: "LED", relay: "Relay" };
const ON_PIN = /^([\w-]+) (\d+)$/;

export function Widget({ step }) {
  const { setup, answer } = step;
  const [, driver, gpio] = ON_PIN.exec(answer) ?? [];
  const [{ pins = [], failed = "" }, know] = useState({});
  const ask = useRef(null);
  ask.current ??= latest(
    async (signal, output) => {
      try {
        const path = `setup/wiring.svg?output=${encodeURIComponent(output)}`;
        const { blob, values } = await api.picture(path, { signal });
        know(values);
        setup.put({ aside: html`<${Circuit} blob=${blob} output=${output} notes=${values.notes} />` });
      } catch (error) {
        if (signal.aborted) return;
        know((was) => ({ ...was, failed: error.message }));
        setup.put({ aside: null }); // it is of the former one
      }
    },
    { calls_off: true },
  );
  useEffect(() => {
    if (driver) ask.current(answer);
    else setup.put({ aside: null });
  }, [answer]);
  useEffect(() => () => ask.current.end(), []);
  const { warning } = pins.find((each) => String(each.gpio) === gpio) ?? {};
  const pin = ({ number, gpio: each, taken_by, warning: danger }) => {
    const note = taken_by.length ? `, taken by ${taken_by.join(", ")}` : danger ? `, used for ${danger}` : "";
    return [each, `GPIO ${each}, pin ${number}${note}`];
  };
  const onPin = html`<div class="stack">
    <${Field} label="What is wired">
      <${Select} options=${PARTS} value=${driver} choose=${(other) => step.set(`${other} ${gpio}`)} /><//>
    <${Field} label="The pin of its signal">
      <${Select} options=${Object.fromEntries(pins.map(pin))} value=${gpio}
        choose=${(other) => step.set(`${driver} ${other}`)} /><//>
    <p class=${`small ${warning && !failed ? "is-warning" : ""}`} role="status">
      ${failed || (warning && `Careful: it is used for ${warning}.`)}</p></div>`;
  return html`<div class="stack"><${Choices} step=${step} />${driver && onPin}<${Held} ...${setup.context} /></div>`;
}

function Circuit({ blob, output, notes }) {
  const [driver, gpio] = output.split(" ");
  return html`<section class="panel stack setup-wiring"><h2>How it is wired</h2>
    <div class="setup-scrolls" tabindex="0" role="group" aria-label="Wiring">
      <${Photo} class="setup-circuit" blob=${blob} alt=${`How the ${driver} is wired to GPIO ${gpio}`} /></div>
    <ul class="setup-words">${notes.map((each) => html`<li>${each}</li>`)}</ul></section>`;
}

/** The outputs of a run that is there, each to be tried while a button is held. */
function Held({ live }) {
  const snapshot = useSnapshot(live, 1000);
  const [said, say] = useState("");
  const levels = (snapshot?.outputs ?? []).filter(({ kind }) => kind === "level").map(({ output }) => output);
  const hold = (output) => {
    const path = `outputs/${encodeURIComponent(output)}/hold`;
    const send = async () => (await api.post(path, { level: 1 }))?.reason ?? "";
    const release = () => api.post(path, { release: true }, { keepalive: true });
    return html`<${HoldButton} key=${output} label=${`Hold to test ${output}`} held=${`${output} is on`} send=${send}
      release=${release} onWords=${say} />`;
  };
  if (!levels.length) return null;
  return html`<p class="quiet small">
      The run that is there now has these outputs. Each is on only while its button is held.</p>
    <div class="row">${levels.map(hold)}</div>
    <p class="small" role="status">${said}</p>`;
}
