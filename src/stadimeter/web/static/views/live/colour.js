// The colour of a ball of the run, by sliders beside what has that colour in the run's picture now.

import { colourSliders } from "../../colour_sliders.js";
import { showModal } from "../../dialog.js";
import { button, h, write } from "../../dom.js";
import { distance } from "../../format.js";
import { Saving } from "../edit/saving.js";

const PAUSE_MS = 60;
const AGAIN_MS = 1500;
const WIDTH_PX = 640;

/** Open the dialog for a target by the name of its table. The run is not touched before it is saved and reloaded. */
export function openColour(target, { api, say, unit }) {
  const path = `targets/${encodeURIComponent(target)}/colour`;
  const stop = new AbortController();
  const saving = new Saving({ api, say });
  const sliders = colourSliders(() => (save.disabled = false));
  const leave = () => close();
  const image = h("img", { alt: "What has this colour" });
  const words = h("p", { class: "small" });
  const wrong = h("p", { class: "banner is-error", role: "alert", hidden: true }); // each picture writes the words anew
  const save = button("Save", keep, "primary", { disabled: true });
  const dialog = h(
    "dialog",
    { class: "colour", "aria-label": `Colour of ${target}` },
    h("h2", null, `Colour of ${target}`),
    h("div", { class: "colour-beside" }, h("div", { class: "stack" }, image, words), sliders.element),
    wrong,
    saving.element,
    h("div", { class: "row end" }, button("Close", leave), save),
  );
  let version = null;
  dialog.addEventListener("close", () => {
    stop.abort();
    URL.revokeObjectURL(image.src);
  });
  const close = showModal(dialog, () => !save.disabled);
  next();

  async function next() {
    let pause = PAUSE_MS;
    try {
      const query = new URLSearchParams({ range: sliders.range, width_px: WIDTH_PX });
      const { blob, values } = await api.picture(`${path}.jpg?${query}`, { signal: stop.signal });
      version ??= values.version;
      if (!sliders.range) sliders.show(values.colour);
      if (sliders.range === values.colour) sliders.tell(values.range);
      const { distance_m, sigma_m } = values;
      write(words, distance_m === null ? values.words : `${distance(distance_m, sigma_m, unit).text}.`);
      URL.revokeObjectURL(image.src);
      image.src = URL.createObjectURL(blob);
      await image.decode().catch(() => {});
    } catch (error) {
      if (stop.signal.aborted) return;
      write(words, error.message);
      pause = AGAIN_MS;
    }
    if (!stop.signal.aborted) setTimeout(next, pause);
  }

  async function keep() {
    save.disabled = wrong.hidden = true;
    try {
      const answer = await api.post(path, { range: sliders.range, base_version: version ?? "" });
      version = answer.version;
      saving.offer(answer);
    } catch (error) {
      save.disabled = false;
      wrong.hidden = false;
      write(wrong, error.message);
      say(error.message, "error");
    }
  }
}
