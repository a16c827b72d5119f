// What follows a save: a run that must reload or restart, and two who save at once.

import { api } from "../../api.js";
import { Difference } from "../../difference.js";
import { Button, html, useEffect, useRef, useState } from "../../ui.js";

const APPLY = {
  reload: { path: "run/reload", words: "Reload the run", why: "The run can take the new rules without a stop." },
  restart: {
    path: "run/restart",
    words: "Restart the run",
    why: "The run must restart for this change. Its outputs go to their safe values meanwhile.",
  },
  start: { path: "run/start", words: "Start the run", why: "No run uses this configuration now." },
  nothing: { why: "The run goes by it already." },
};

/** Says what is needed for the run to use what was saved, and does it on a button. */
export function Saved({ needs, say }) {
  const [isOver, end] = useState(false);
  const { path, words, why } = APPLY[needs] ?? APPLY.nothing;
  const apply = async () => {
    try {
      const answer = await api.post(path);
      const changed = answer?.changed?.length ? `Done; changed: ${answer.changed.join(", ")}.` : "Done.";
      end(true);
      say(answer?.words ?? changed);
    } catch (error) {
      say(error.message, "error");
    }
  };
  if (isOver) return null;
  const acts = html`<div class="row"><${Button} kind="primary" onclick=${apply}>${words}<//>
    <${Button} onclick=${() => end(true)}>Not now<//></div>`;
  return html`<section class="panel stack" aria-label="Saved">
    <p><strong>Saved.${" "}</strong>${why}</p>
    ${path && acts}
  </section>`;
}

/** Another saved since: shows what they changed, and lets the person choose. Nothing is lost either way. */
export function Conflict({ base, theirs, keepMine, takeTheirs }) {
  const root = useRef();
  useEffect(() => root.current.scrollIntoView({ block: "nearest" }), []);
  return html`<section class="panel stack" aria-label="Changed meanwhile" ref=${root}>
    <h2>Someone else saved this configuration since you opened it</h2>
    <p>Nothing was saved. Your text is still in the field. They changed:</p>
    <${Difference} before=${base.text} after=${theirs.text} label="What was changed meanwhile"
      none="Their text is the one that you began with." />
    <div class="row"><${Button} kind="primary" onclick=${keepMine}>Save mine in place of theirs<//>
      <${Button} onclick=${takeTheirs}>Use theirs<//></div>
    <p class="quiet">The text that is replaced is kept among the versions below.</p>
  </section>`;
}
