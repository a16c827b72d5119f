// The camera: those that are there, with a picture of each.

import { h, replace } from "../../dom.js";
import { choices } from "./question.js";

export function widget(step) {
  const urls = [];
  const looks = [];
  const cards = choices(step, {
    draw: (option) => {
      const view = h("span", { class: "setup-look quiet small" }, "Looking …");
      looks.push([option, view]);
      return view;
    },
  });
  let isOver = false;
  step.setup.onLeave(() => ((isOver = true), urls.forEach((url) => URL.revokeObjectURL(url))));
  look();
  return cards;

  async function look() {
    for (const [option, view] of looks) {
      if (isOver) return;
      try {
        const { blob, values } = await step.api.picture("setup/camera", { method: "POST", body: { camera: option.answer, width_px: 480 } });
        const url = URL.createObjectURL(blob);
        urls.push(url);
        replace(view, h("img", { src: url, alt: `What ${option.answer} sees` }), values && h("span", null, `${values.width_px} × ${values.height_px}`));
      } catch (error) {
        replace(view, h("span", { class: "is-wrong" }, error.message));
      }
    }
  }
}
