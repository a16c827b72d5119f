// The colour of a ball: click on it, look at the mask, widen or narrow the range, and click again in another light.

import { h, replace } from "../../dom.js";

export function widget(step) {
  const { picture, question } = step;
  const state = { clicks: [], counted: [], others: [], pictures: 0, view: "mask" };
  const words = h("p", { role: "status", class: "setup-found" }, question.ready ? "" : "Click on the ball.");
  const slider = h("input", { type: "range", min: -12, max: 12, step: 1, value: 0, disabled: !question.ready, "aria-label": "Range of colours: narrower to wider", oninput: widened });
  const again = h("button", { type: "button", class: "button", onclick: forget }, "Forget the clicks");
  const look = h("button", { type: "button", class: "button", onclick: () => ask({ look: true }) }, "Look for it");
  const kept = h("div", { class: "row small" });
  const views = h("div", { class: "setup-views row", role: "group", "aria-label": "What the picture shows" },
    [["mask", "What has this colour"], ["candidates", "Ball, and what is refused"], ["plain", "Plain"]].map(([view, name]) =>
      h("button", { type: "button", class: "button", "aria-pressed": String(view === state.view), onclick: (event) => shown(view, event.currentTarget) }, name)));
  const refused = h("ol", { class: "setup-refused small" });
  let isAsking = false;
  let waiting = null;

  picture.mode({ draw: "mask", isSaid: true, onPlace: clicked, onCross: draw });
  replace(picture.below, views, refused);
  picture.onValues((values) => {
    draw();
    const list = state.view === "candidates" ? values.rejected ?? [] : [];
    replace(refused, list.map((each) => h("li", null, each.reason)));
  });
  step.text.addEventListener("change", () => ask({ range: step.answer }));
  ask(question.ready ? { range: question.ready } : {}, true);
  picture.stage.dataset.first = "";
  step.setup.onLeave(() => delete picture.stage.dataset.first);
  tell();

  return h("div", { class: "stack" },
    h("p", null, "Click on the ball in the picture. Click again where the light falls otherwise, and in another light: the clicks count together."),
    words, kept,
    h("label", { class: "field" }, h("span", null, "Narrower or wider"), slider),
    h("div", { class: "row" }, look, again));

  function clicked(x_px, y_px) {
    state.clicks.push({ x_px, y_px });
    ask({ clicks: [[x_px, y_px]], of: "newest" });
  }

  function widened() {
    ask({ widen: Number(slider.value) });
  }

  function forget() {
    state.clicks = [];
    ask({ forget: true });
  }

  /** Ask one after the other; of several that wait, the newest. */
  async function ask(args, isQuiet = false) {
    if (isAsking) return void (waiting = args);
    isAsking = true;
    step.progress.hidden = false;
    try {
      taken(await step.api.post("setup/colour", args), args);
    } catch (error) {
      if (args.clicks) state.clicks.pop();
      if (!isQuiet) step.say(error.message);
    }
    isAsking = false;
    step.progress.hidden = true;
    if (!waiting) return;
    const next = waiting;
    waiting = null;
    ask(next);
  }

  function taken(answer, args) {
    Object.assign(state, { others: answer.others, pictures: answer.pictures, counted: answer.clicks });
    if (answer.range || args.forget !== undefined) step.set(answer.range);
    step.say("");
    slider.disabled = !answer.range;
    if (answer.widen !== undefined) Object.assign(slider, { value: answer.widen, min: -answer.widen_max, max: answer.widen_max });
    replace(words, answer.words);
    words.classList.toggle("is-good", answer.found && !answer.others.length);
    words.classList.toggle("is-warning", Boolean(answer.range) && (!answer.found || answer.others.length > 0));
    if (args.clicks) setTimeout(() => (state.clicks = []), 1200); // the ball may move on
    tell();
  }

  function tell() {
    again.hidden = !state.pictures;
    replace(kept,
      state.pictures > 0 && h("span", { class: "quiet" }, `${state.pictures} ${state.pictures === 1 ? "picture counts" : "pictures count"}.`),
      state.counted.map(([x_px, y_px], number) =>
        h("button", { type: "button", class: "button small", "aria-label": `Forget click ${number + 1}, at ${x_px}, ${y_px}`, onclick: () => ask({ forget: number }) }, `${x_px}, ${y_px} ✕`)));
  }

  function draw() {
    picture.mark([
      ...state.clicks.map((each) => ({ ...each })),
      ...state.others.map(({ centre_px: [x_px, y_px] }) => ({ x_px, y_px, kind: "other", label: "same colour" })),
      ...(picture.cross ? [{ x_px: picture.cross[0], y_px: picture.cross[1], kind: "cross" }] : []),
    ]);
  }

  function shown(view, button) {
    state.view = view;
    picture.draw(view);
    for (const each of views.children) each.setAttribute("aria-pressed", String(each === button));
  }
}
