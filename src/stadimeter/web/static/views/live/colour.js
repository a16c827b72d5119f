// The colour of a ball of the run, by sliders beside what has that colour in the run's picture now.

import { api } from "../../api.js";
import { ColourSliders } from "../../colour_sliders.js";
import { openDialog } from "../../dialog.js";
import { distance } from "../../format.js";
import { Button, html, Photo, useAgain, useRef, useState } from "../../ui.js";
import { Saved } from "../edit/saving.js";

const WIDTH_PX = 640;

/** Open the dialog for a target by the name of its table. The run is not touched before it is saved and reloaded. */
export function openColour(target, context) {
  const changed = { isIt: false };
  const draw = (leave) => html`<${Colour} target=${target} changed=${changed} leave=${leave} ...${context} />`;
  openDialog({ label: `Colour of ${target}`, kind: "colour", isChanged: () => changed.isIt }, draw);
}

function Colour({ target, changed, leave, ...context }) {
  const { unit } = context;
  const path = `targets/${encodeURIComponent(target)}/colour`;
  const [range, choose] = useState("");
  const [shown, show] = useState({ words: "" }); // `{blob, figures, words}`
  const [saved, save] = useState(null); // `{answer}`, or `{failed}`: each picture writes the words anew
  const [isChanged, change] = useState(false);
  const version = useRef();
  changed.isIt = isChanged;
  useAgain(
    async (signal) => {
      const query = new URLSearchParams({ range, width_px: `${WIDTH_PX}` });
      const { blob, values } = await api.picture(`${path}.jpg?${query}`, { signal });
      version.current ??= values.version;
      if (!range) choose(values.colour);
      const words =
        values.distance_m === null ? values.words : `${distance(values.distance_m, values.sigma_m, unit).text}.`;
      show({ blob, words, figures: values.range });
    },
    (error) => show((was) => ({ ...was, words: error.message })),
  );
  const chosen = (wanted) => (choose(wanted), change(true));
  const keep = async () => {
    change(false);
    try {
      const answer = await api.post(path, { range, base_version: version.current ?? "" });
      version.current = answer.version;
      save({ answer });
    } catch (error) {
      change(true);
      save({ failed: error.message });
      context.say(error.message, "error");
    }
  };
  return html`<div class="stack"><h2>Colour of ${target}</h2>
    <div class="colour-beside">
      <div class="stack"><${Photo} blob=${shown.blob} alt="What has this colour" /><p class="small">${shown.words}</p></div>
      <${ColourSliders} range=${range} onrange=${chosen} figures=${shown.figures} /></div>
    ${saved?.failed && html`<p class="banner is-error" role="alert">${saved.failed}</p>`}
    ${saved?.answer && html`<${Saved} key=${saved.answer.version} ...${saved.answer} ...${context} />`}
    <div class="row end"><${Button} onclick=${leave}>Close<//>
      <${Button} kind="primary" disabled=${!isChanged} onclick=${keep}>Save<//></div>
  </div>`;
}
