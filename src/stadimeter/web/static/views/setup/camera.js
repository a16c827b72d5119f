// The camera: those that are there, with a picture of each; the one that is chosen is shown live, with its exposure.

import { h, replace } from "../../dom.js";
import { choices } from "./question.js";

const SETTLED_MS = 500;

export function widget(step) {
  const { setup, api } = step;
  const urls = [];
  const views = new Map();
  const cards = choices(step, {
    draw: ({ answer }) => {
      const view = h("span", { class: "setup-look quiet small" }, "Looking …");
      views.set(answer, view);
      return view;
    },
  });
  const exposure = h("div", { class: "stack setup-exposure", role: "status" });
  let turn = Promise.resolve(); // one camera at a time
  let asked = 0;
  let timer = 0;
  setup.onLeave(() => {
    asked = Infinity;
    clearTimeout(timer);
    for (const url of urls) URL.revokeObjectURL(url);
  });
  for (const [answer, view] of views) look(answer, view);
  step.onAnswer((answer) => {
    clearTimeout(timer);
    timer = setTimeout(() => chosen(answer), SETTLED_MS);
  });
  return h("div", { class: "stack" }, cards, exposure);

  /** Look through a camera once, for its card. */
  function look(answer, view) {
    turn = turn.then(async () => {
      if (asked === Infinity) return;
      try {
        const { width_px, height_px } = await api.post("setup/camera", { camera: answer });
        const { blob } = await api.picture("setup/picture.jpg?draw=plain&width_px=320");
        const url = URL.createObjectURL(blob);
        urls.push(url);
        replace(view, h("img", { src: url, alt: `What ${answer} sees` }), h("span", null, `${width_px} × ${height_px} pixels`));
      } catch (error) {
        replace(view, h("span", { class: "is-wrong" }, error.message));
      }
    });
  }

  /** Say what is to be said of the camera that is chosen: blur, clipping, and its exposure, which may be locked. */
  function chosen(answer, changes = null) {
    const mine = ++asked;
    turn = turn.then(async () => {
      if (mine !== asked || !answer) return;
      try {
        const told = await api.post("setup/camera", { camera: answer, ...changes });
        if (mine === asked) tell(answer, told, Boolean(changes));
      } catch (error) {
        if (mine === asked && (changes || !views.has(answer))) step.say(error.message);
        if (mine === asked && !changes) replace(exposure);
      }
    });
  }

  function tell(answer, { remarks, settings, width_px, height_px, has_resolution, has_exposure, is_locked, proposed_exposure_s, exposure_s, answer: wanted }, isTaken) {
    if (isTaken && wanted !== step.answer) {
      clearTimeout(timer);
      step.set(wanted);
      clearTimeout(timer);
    }
    const now_s = proposed_exposure_s ?? exposure_s ?? 0.01;
    const time = h("input", { type: "text", value: `${Number((1000 * now_s).toPrecision(2))} ms`, "aria-label": "Exposure" });
    const lock = h("button", { type: "button", class: "button", onclick: () => chosen(step.answer, { exposure: time.value }) }, is_locked ? "Change it" : "Lock it");
    const size = h("input", { type: "text", value: `${width_px}x${height_px}`, autocomplete: "off", "aria-label": "Resolution" });
    const ask = h("button", { type: "button", class: "button", onclick: () => chosen(step.answer, { resolution: size.value }) }, "Ask for it");
    replace(exposure,
      [...remarks, ...settings].map((each) => h("p", { class: "small" }, each)),
      has_resolution && h("div", { class: "field" }, h("span", null, "Resolution in pixels: it is measured at this one"), h("div", { class: "setup-size" }, size, ask)),
      has_exposure && h("div", { class: "field" }, h("span", null, is_locked ? "Exposure: locked" : "Exposure: automatic. Locked, the colours stay as they are"), h("div", { class: "setup-size" }, time, lock)));
  }
}
