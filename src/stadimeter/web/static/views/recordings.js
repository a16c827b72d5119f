// Recordings: make one, list, replay with a slider, download, delete.

import { api } from "../api.js";
import { ask } from "../dialog.js";
import * as format from "../format.js";
import { latest } from "../latest.js";
import { Badge, Button, html, useEffect, useRef, useSnapshot, useState } from "../ui.js";
import { Record } from "./live/picture.js";
import { Replay } from "./replay.js";

const CLIP_END_S = 2; // a clip is finished within a second or so after its end

export function View(context) {
  const { say, session } = context;
  const canOperate = session.right === "operate";
  const [told, load] = useRecordings();
  const [{ name, at_s }, show] = useState(named(location.hash)); // what is replayed
  const remove = async (gone) => {
    const words = "It is gone for good. Download it first if you may need it.";
    const send = () => api.del(`recordings/${encodeURIComponent(gone)}`);
    if (!(await ask({ title: `Delete ${gone}?`, words, action: "Delete", isDangerous: true, send }))) return;
    if (gone === name) show({});
    say(`${gone} is deleted.`);
    load();
  };
  const replayed = canOperate && told.recordings?.find((each) => each.name === name);
  const row = (each) => html`<${Recording} key=${each.name} recording=${each} canOperate=${canOperate}
    open=${() => show({ name: each.name, at_s: 0 })} remove=${() => remove(each.name)} />`;
  const { recordings, failed, folder, left_out } = told;
  const none =
    "There are none yet. A recording holds the pictures, what was measured in them, and what the rules decided.";
  const left = left_out > 0 && `${left_out} older ones are not listed.`;
  return html`<div class="stack">
    <section class="panel stack of-run" aria-label="Record"><h1>Recordings</h1>
      <${Orders} load=${load} canOperate=${canOperate} ...${context} /></section>
    ${replayed && html`<${Replay} key=${`${name} ${at_s}`} ...${replayed} at_s=${at_s} end=${() => show({})} ...${context} />`}
    <section class="panel" aria-label="List">
      <ul class="list recordings">
        ${(failed || recordings?.length === 0) && html`<li>${failed || none}</li>`}
        ${recordings?.map(row)}</ul>
      <p class="quiet small">${[folder && canOperate && `In ${folder}.`, left].filter(Boolean).join(" ")}</p>
    </section>
  </div>`;
}

/** The recordings that there are, and what asks for them anew. */
function useRecordings() {
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
  return name ? { name: decodeURIComponent(name), at_s: Number(at_s) || 0 } : {};
}

function Orders({ live, say, load, canOperate }) {
  const recording = useSnapshot(live)?.recording;
  const isLive = live.state.status === "live";
  useEffect(() => void load(), [Boolean(recording)]);
  const keep = async () => {
    try {
      const { words, seconds } = await api.post("recordings/clip", { by: localStorage.getItem("name") || undefined });
      say(words);
      setTimeout(load, 1000 * (seconds + CLIP_END_S));
    } catch (error) {
      say(error.message, "error");
    }
  };
  const going = recording && `Recording: ${format.span(recording.seconds)}, ${format.size(recording.bytes)}.`;
  const idle = isLive ? "A recording can be replayed here, and changed rules be tried on it." : "There is no run now.";
  const acts = html`<${Record} disabled=${!isLive} recording=${recording} say=${say} done=${load} />
    <${Button} onclick=${keep}>Save clip<//>`;
  return html`<div class="row">${canOperate && acts}<p class="grow">${(isLive && going) || idle}</p></div>`;
}

/** Why a clip was written: what happened, or which person saved it. */
function why({ kind, source, reason }) {
  if (kind === "order") return `Saved from ${source}${reason ? `: ${reason}` : ""}`;
  return `${source} ${kind}: ${reason}`;
}

function Recording({ recording, canOperate, open, remove }) {
  const { name, seconds, bytes, unix_s, configuration, damage, is_growing, clip_of } = recording;
  const facts = [
    clip_of && why(clip_of),
    format.moment(unix_s),
    seconds === null ? "" : format.span(seconds),
    format.size(bytes),
    configuration,
  ];
  const path = `/api/v1/recordings/${encodeURIComponent(name)}`;
  const canReplay = seconds > 0;
  const acts = html`<div class="row">
    ${canReplay && html`<${Button} label=${`Replay ${name}`} onclick=${open}>Replay<//>`}
    <a class="button" href=${path} download=${name} aria-label=${`Download ${name}`} hidden=${is_growing}>Download</a>
    ${!is_growing && html`<${Button} label=${`Delete ${name}`} onclick=${remove}>Delete<//>`}</div>`;
  return html`<li>
    <div class="row"><div class="grow"><strong>${name}</strong>
        ${is_growing && html` <${Badge} kind="alarm">recording<//>`}
        <p class="quiet">${facts.filter(Boolean).join(" · ")}</p></div>
      ${canOperate && acts}</div>
    ${damage && html`<p class="damaged">▲ Damaged: ${damage}</p>`}
  </li>`;
}
