// What the text in the field would have done on a recording: both runs, one above the other.

import { api } from "../../api.js";
import { words as inUnit, span } from "../../format.js";
import { latest } from "../../latest.js";
import { Button, html, Model, Select, useEffect, useModel, useState } from "../../ui.js";
import { Chart, TimelineChart } from "../timeline/chart.js";
import { gridded, readAt } from "../timeline/data.js";

const FOR_S = 3; // until there is something to show
const STEPS = 800;

/** `desk` is that of the view. */
export function Trying({ desk }) {
  const trial = useModel(Trial, { desk });
  const [chosen, choose] = useState();
  useEffect(() => void trial.load(), []);
  const { recordings, failed, words, answer, read } = trial;
  const isShown = trial.text === desk.text; // what another text would have done is shown no longer
  const names = recordings?.map(({ name, seconds }) => [name, `${name} (${span(seconds)})`]) ?? [];
  const ask = () => trial.ask(chosen ?? names[0][0]);
  const none = html`<p>There is no recording yet: make one under <a href="#recordings">Recordings</a>.</p>`;
  const choice = html`<div class="row">
    <${Select} aria-label="Recording" options=${Object.fromEntries(names)} value=${chosen} choose=${choose} />
    <${Button} disabled=${trial.isBusy} onclick=${ask}>What would this have done?<//></div>`;
  return html`<section class="panel stack" aria-label="On a recording"><h2>On a recording</h2>
    <p class="quiet">The rules in the field, on what the camera saw then, beside what was decided then. Nothing moves.</p>
    ${failed && html`<p>${failed}</p>`}
    ${recordings?.length === 0 && none}
    ${names.length > 0 && choice}
    <div class="stack" hidden=${!isShown}>
      <div class="stack" role="status">
        ${words && html`<p>${words}</p>`}${answer && html`<${Told} ...${answer} unit=${desk.unit} />`}</div>
      <div hidden=${!answer}><${Chart} chart=${trial.chart} /></div>
      <p class="small number read">${read}</p>
    </div>
  </section>`;
}

function Told({ progress, words, differences, unit }) {
  const title = differences.length === 1 ? "1 event differs" : `${differences.length} events differ`;
  const changes = differences.map((each) => html`<${Changed} ...${each} unit=${unit} />`);
  return html`${progress < 1 && html`<progress value=${progress} aria-label="Replayed" />`}
    <ul class="words">${words.map((each) => html`<li>${inUnit(each, unit)}</li>`)}</ul>
    ${differences.length > 0 && html`<details><summary>${title}</summary><ul class="list">${changes}</ul></details>`}`;
}

const SIGNS = { added: "now, not then", lost: "then, not now" };

function Changed({ change, by_s, at_s, kind, source, reason, unit }) {
  const how = SIGNS[change] ?? `moved by ${by_s > 0 ? "+" : ""}${by_s.toFixed(2)} s`;
  return html`<li><strong>${at_s.toFixed(2)} s, ${source}: ${kind.replaceAll("_", " ")}, ${how}.${" "}</strong>
    ${inUnit(reason, unit)}</li>`;
}

class Trial extends Model {
  words = "";
  read = "";
  chart = new TimelineChart({
    unit: this.desk.unit,
    label: "Both runs: arrow keys read them",
    onread: (unix_s) => {
      this.put({ read: unix_s === null ? "" : readAt(this.drawn, unix_s, this.desk.unit) });
      return this.read;
    },
  });

  leave() {
    this.ask.end();
  }

  async load() {
    try {
      const { recordings } = await api.get("recordings");
      this.put({ recordings: recordings.filter((each) => each.seconds > 0) });
    } catch (error) {
      this.put({ failed: error.message });
    }
  }

  /** Each answer shows what is compared so far; a long recording takes several. */
  ask = latest(async (signal, name) => {
    const { text } = this.desk;
    const { unix_s } = this.recordings.find((each) => each.name === name);
    const path = `recordings/${encodeURIComponent(name)}/replay-diff`;
    this.put({ text, answer: null, words: "Replaying …", isBusy: true });
    try {
      for (let progress = 0; progress < 1 && this.desk.text === text; ) {
        const answer = await api.post(path, { text, for_s: FOR_S }, { signal });
        progress = answer.progress;
        this.put({ answer, words: "" });
        this.#show(answer, unix_s);
      }
    } catch (error) {
      if (signal.aborted) return;
      if (error.problems?.length) this.desk.show(error);
      this.words = error.message;
    } finally {
      this.put({ isBusy: false });
    }
  });

  #show({ to_s, samples, thresholds_m, lanes }, began_s) {
    const step_s = Math.max(to_s, 1) / STEPS;
    const lane = (rule, spans) => ({
      rule,
      spans: spans.map((each) => [each.from_s + began_s, each.to_s + began_s, "active"]),
    });
    this.drawn = {
      times: Array.from({ length: STEPS }, (_, at) => began_s + (at + 0.5) * step_s),
      targets: Object.fromEntries(Object.entries(samples).map(([name, each]) => [name, gridded(each, STEPS, step_s)])),
      lanes: lanes.flatMap(({ rule, before, after }) => [lane(`${rule}, then`, before), lane(`${rule}, now`, after)]),
      events: [],
      clips: [],
    };
    this.chart.thresholds = thresholds_m.map((value_m) => ({ rule: "", value_m }));
    this.chart.setView(began_s, began_s + to_s);
    this.chart.setData(this.drawn);
  }
}
