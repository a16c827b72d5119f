// Recordings: make one, list, replay with a slider, download, delete.

import { ask } from "../dialog.js";
import * as format from "../format.js";
import { latest } from "../latest.js";
import { Badge, Button, html, useEffect, useRef, useSnapshot, useState } from "../ui.js";
import { Replay } from "./replay.js";

const CLIP_END_S = 2; // a clip is finished within a second or so after its end

export function View(context) {
  const { api, say, session } = context;
  const canOperate = session.right === "operate";
  const [told, load] = useRecordings(api);
  const [shown, show] = useState(named(location.hash)); // `{name, at_s}`: what is replayed
  const order = async (path, body) => {
    try {
      const { words, seconds } = await api.post(path, body);
      if (words) say(words);
      if (seconds) setTimeout(load, 1000 * (seconds + CLIP_END_S));
    } catch (error) {
      say(error.message, "error");
    }
    return load();
  };
  const remove = async ({ name }) => {
    const words = "It is gone for good. Download it first if you may need it.";
    const send = () => api.del(`recordings/${encodeURIComponent(name)}`);
    if (!(await ask({ title: `Delete ${name}?`, words, action: "Delete", isDangerous: true, send }))) return;
    if (shown?.name === name) show(null);
    say(`${name} is deleted.`);
    load();
  };
  const replayed = canOperate && told.recordings?.find(({ name }) => name === shown?.name);
  const row = (each) => html`<${Recording} key=${each.name} recording=${each} canOperate=${canOperate}
    open=${() => show({ name: each.name, at_s: 0 })} remove=${() => remove(each)} />`;
  return html`<div class="stack">
    <section class="panel stack of-run" aria-label="Record"><h1>Recordings</h1>
      <${Orders} live=${context.live} load=${load} order=${canOperate && order} /></section>
    ${
      replayed &&
      html`<${Replay} key=${`${shown.name} ${shown.at_s}`} ...${replayed} at_s=${shown.at_s}
      ...${context} end=${() => show(null)} />`
    }
    <section class="panel" aria-label="List">
      <ul class="list recordings">
        ${told.failed && html`<li>${told.failed}</li>`}
        ${told.recordings?.map(row)}
        ${
          told.recordings?.length === 0 &&
          html`<li>There are none yet. A recording holds the pictures, what was measured
          in them, and what the rules decided.</li>`
        }
      </ul>
      <p class="quiet small">${told.folder && `In ${told.folder}.`}
        ${told.left_out > 0 && ` ${told.left_out} older ones are not listed.`}</p>
    </section>
  </div>`;
}

/** The recordings that there are, and what asks for them anew. */
function useRecordings(api) {
  const [told, set] = useState({ recordings: null });
  const load = useRef(null);
  load.current ??= latest(async (signal) => {
    try {
      set(await api.get("recordings", { signal }));
    } catch (error) {
      if (!signal.aborted) set({ recordings: null, failed: error.message });
    }
  });
  useEffect(() => () => load.current.end(), []);
  return [told, load.current];
}

/** The recording that the address names, and its moment: `#recordings/NAME/SECONDS`. */
function named(hash) {
  const [, name, at_s] = hash.split("/");
  return name ? { name: decodeURIComponent(name), at_s: Number(at_s) || 0 } : null;
}

function Orders({ live, load, order }) {
  const recording = useSnapshot(live)?.recording;
  const isLive = live.state.status === "live";
  useEffect(() => void load(), [Boolean(recording)]);
  const [isAsking, set] = useState(false);
  const record = async () => {
    set(true);
    await order("recordings", { do: recording ? "stop" : "start" });
    set(false);
  };
  const keep = () => order("recordings/clip", { by: localStorage.getItem("name") || undefined });
  const words = !isLive
    ? "There is no run to record now."
    : recording
      ? `Recording: ${format.span(recording.seconds)}, ${format.size(recording.bytes)}.`
      : "A recording can be replayed here, and changed rules be tried on it.";
  return html`<div class="row">
    ${
      order &&
      html`<${Button} kind="primary" disabled=${isAsking || !isLive} onclick=${record}>
        ${recording ? "Stop recording" : "Record"}<//>
      <${Button} onclick=${keep}>Save clip<//>`
    }
    <p class="grow">${words}</p></div>`;
}

function Recording({ recording, canOperate, open, remove }) {
  const { name, kind, seconds, bytes, unix_s, configuration, damage, is_growing, clip_of } = recording;
  const facts = [
    clip_of && `${clip_of.source} ${clip_of.kind}: ${clip_of.reason}`,
    format.moment(unix_s),
    seconds === null ? "" : format.span(seconds),
    format.size(bytes),
    configuration,
    kind === "journal" ? "no pictures" : "",
  ];
  const path = `/api/v1/recordings/${encodeURIComponent(name)}`;
  const canReplay = seconds > 0 && kind === "recording";
  return html`<li>
    <div class="row"><div class="grow"><strong>${name}</strong>
        ${is_growing && html` <${Badge} kind="alarm">recording<//>`}
        <p class="quiet">${facts.filter(Boolean).join(" · ")}</p></div>
      ${
        canOperate &&
        html`<div class="row">
        ${canReplay && html`<${Button} label=${`Replay ${name}`} onclick=${open}>Replay<//>`}
        ${
          !is_growing &&
          html`<a class="button" href=${path} download=${name} aria-label=${`Download ${name}`}>Download</a>
          <${Button} label=${`Delete ${name}`} onclick=${remove}>Delete<//>`
        }</div>`
      }</div>
    ${damage && html`<p class="damaged">▲ Damaged: ${damage}</p>`}
  </li>`;
}
