// One recording, moment by moment: its picture, what was measured, and what the rules made of it.

import { api } from "../api.js";
import * as format from "../format.js";
import { latest } from "../latest.js";
import { Button, html, Model, Photo, useEffect, useModel, useRef } from "../ui.js";

const STEP_S = 0.1;

export function Replay({ name, seconds, at_s, unit, end }) {
  const player = useModel(Player, { name, seconds });
  const [root, slider] = [useRef(), useRef()];
  useEffect(() => {
    player.show(at_s);
    slider.current.focus({ preventScroll: true });
    root.current.scrollIntoView({ block: "start" });
  }, []);
  const { shown, failed, isPlaying } = player;
  const now = player.at_s.toFixed(1);
  return html`<section class="panel stack" aria-label=${`Replay of ${name}`} ref=${root}>
    <div class="row"><h2 class="grow">${name}</h2><${Button} onclick=${end}>Close<//></div>
    <div class="replay">
      <div class="stack"><figure><${Photo} blob=${shown?.blob} alt="The camera's picture at that moment" /></figure>
        <input type="range" min="0" max=${seconds} step=${STEP_S} value=${player.at_s} ref=${slider}
          aria-label="Moment of the recording" aria-valuetext=${`${now} of ${seconds.toFixed(1)} seconds`}
          oninput=${(event) => player.move(Number(event.target.value))} />
        <div class="row"><${Button} onclick=${() => player.play()}>${isPlaying ? "Pause" : "Play"}<//>
          <output>${now} s of ${seconds.toFixed(1)} s</output></div></div>
      <div class="stack">${failed ? html`<p>${failed}</p>` : shown && html`<${Moment} ...${shown.values} unit=${unit} />`}</div>
    </div>
  </section>`;
}

class Player extends Model {
  at_s = 0;
  shown = null; // `{blob, values}`
  failed = "";
  #begun_ms = null; // of the playing that goes on

  get isPlaying() {
    return this.#begun_ms !== null;
  }

  leave() {
    this.#begun_ms = null;
    this.#load.end();
  }

  /** Show a moment; while one is on its way, only the newest wish is kept. */
  show(at_s) {
    this.put({ at_s: Math.min(this.seconds, Math.max(0, at_s)) });
    return this.#load(this.at_s);
  }

  move(at_s) {
    this.#begun_ms = null;
    return this.show(at_s);
  }

  #load = latest(async (signal, at_s) => {
    try {
      const path = `recordings/${encodeURIComponent(this.name)}/frame.jpg?at_s=${at_s}`;
      this.put({ shown: await api.picture(path, { signal }), failed: "" });
    } catch (error) {
      if (signal.aborted) return;
      this.#begun_ms = null;
      this.put({ failed: error.message });
    }
  });

  /** Play at the pace of the clock, as many pictures as come; or pause. */
  async play() {
    const from_s = this.at_s >= this.seconds ? 0 : this.at_s;
    const begun_ms = this.isPlaying ? null : performance.now();
    this.#begun_ms = begun_ms;
    this.draw();
    while (begun_ms !== null && this.#begun_ms === begun_ms) {
      await this.show(from_s + (performance.now() - begun_ms) / 1000);
      await new Promise(requestAnimationFrame);
      if (this.at_s >= this.seconds) this.leave();
    }
    this.draw();
  }
}

/** What was at a moment, as `recordings/NAME/frame.jpg` and `timeline/moment` tell it. */
export function Moment({ unix_s, targets, rules, outputs = [], events = [], safety, unit, measured = "Measured" }) {
  const { mode, reason } = safety ?? { mode: "active" };
  const row = (name, value, why = "") => html`<li><strong>${name}</strong> ${value}
    ${why && html`<p class="quiet">${format.words(why, unit)}</p>`}</li>`;
  const part = (title, rows) =>
    rows.length > 0 && html`<section><h3>${title}</h3><ul class="list">${rows}</ul></section>`;
  const distance = (each) => (each.is_valid ? format.distance(each.distance_m, each.sigma_m, unit).text : each.status);
  const happened = ({ source, kind }) => `${source} ${kind.replaceAll("_", " ")}`;
  return html`<p class="quiet">${format.moment(unix_s)}</p>
    ${mode !== "active" && html`<p class="damaged">Outputs were at their safe values: ${reason || mode}</p>`}
    ${part(
      measured,
      targets.map((each) => row(each.name, distance(each), each.reason)),
    )}
    ${part(
      "Rules",
      rules.map((each) => row(each.rule, each.status, each.reason)),
    )}
    ${part(
      "Outputs",
      outputs.map((each) => row(each.output, driven(each, unit), each.reason)),
    )}
    ${part(
      "Events",
      events.map((each) => row(format.moment(each.unix_s), happened(each), each.reason)),
    )}`;
}

function driven({ kind, level, linear_mps, angular_radps }, unit) {
  if (kind === "motion")
    return `${format.speed(linear_mps ?? 0, unit)}, turning ${Math.round(((angular_radps ?? 0) * 180) / Math.PI)}°/s`;
  return format.level(level ?? 0);
}
