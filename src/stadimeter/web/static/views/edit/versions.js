// The former versions of the configuration, and bringing one back.

import { api } from "../../api.js";
import { ask } from "../../dialog.js";
import { Difference } from "../../difference.js";
import { moment } from "../../format.js";
import { Button, html, useState } from "../../ui.js";

/** `desk` is that of the view. */
export const Versions = ({ desk }) => html`<section class="panel" aria-label="Versions">
  <h2>Former versions</h2>
  <ul class="list versions">
    ${!desk.versions.length && html`<li class="quiet">None yet. Each save keeps the text that it replaces.</li>`}
    ${desk.versions.map((each) => html`<${Version} key=${each.id} ...${each} desk=${desk} />`)}
  </ul>
</section>`;

const COMPARED = { label: "From that version to the text in the field", none: "The text in the field is the same." };

function Version({ id, unix_s, desk }) {
  const [text, show] = useState(null); // that of the version, while it is compared
  const title = moment(unix_s);
  const path = `configuration/versions/${encodeURIComponent(id)}`;
  const compare = async () => {
    try {
      show(text === null ? (await api.get(path)).text : null);
    } catch (error) {
      desk.say(error.message, "error");
    }
  };
  const bring = async () => {
    const about = "It becomes the saved configuration. The one that is saved now is kept among the versions.";
    const send = () => api.post(`${path}/restore`, { base_version: desk.base.version });
    const question = { title: `Bring back the version of ${title}?`, words: about, action: "Bring back", send };
    const done = await ask(question);
    if (done) desk.saved(done.answer, desk.use);
  };
  return html`<li class="stack">
    <div class="row">
      <strong class="grow">${title}</strong>
      <${Button} onclick=${compare} aria-expanded=${String(text !== null)} label=${`Compare the version of ${title}`}>
        Compare<//>
      <${Button} onclick=${bring} label=${`Bring back the version of ${title}`}>Bring back<//>
    </div>
    ${text !== null && html`<${Difference} before=${text} after=${desk.text} ...${COMPARED} />`}
  </li>`;
}
