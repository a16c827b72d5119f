// The picture of the camera beside the questions: newest first, with what was found in it, and places to click on.

import { api } from "../../api.js";
import { distance } from "../../format.js";
import { html, Photo, useAgain, useRef, useState } from "../../ui.js";

const WIDTH_PX = 960;
const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const WAY = "The picture. Arrow keys move a cross, with shift by one pixel; Enter takes the place under it.";
const SHAPES = {
  click: "M-2.2 0H2.2M0-2.2V2.2",
  cross: "M-6 0H-1M1 0H6M0-6V-1M0 1V6",
  other: "M0-3 3 0 0 3-3 0Z",
};

/** `draw` names what is drawn into it. With `places`, one is chosen by a click or by keys: `places.onPlace(x_px, y_px)`
 *  hears of it, `places.onValues(values)` of the values of each picture, and `places.marks` are shown:
 *  `[{x_px, y_px, label, kind}]`, in the pixels of the camera. Then what is found is said elsewhere. */
export function Picture({ setup, draw = "target", places = null }) {
  const { unit } = setup;
  const [shown, show] = useState({}); // `{blob, values}`, or why there is none: `{failed}`
  const [cross, put] = useState(null);
  const marks = useRef();
  const { values, failed } = shown;
  useAgain(
    async (signal) => {
      const found = await api.picture(`setup/picture.jpg?draw=${draw}&width_px=${WIDTH_PX}`, { signal });
      if (signal.aborted) return;
      show(found);
      places?.onValues(found.values);
    },
    (error) => {
      show((was) => ({ ...was, failed: error.message }));
      return setup.sync().catch(() => {});
    },
    setup.isLooking,
  );
  const clicked = (event) => {
    if (event.button || !values) return;
    const to = new DOMPoint(event.clientX, event.clientY).matrixTransform(marks.current.getScreenCTM().inverse());
    if (to.x >= 0 && to.y >= 0 && to.x < values.width_px && to.y < values.height_px)
      places.onPlace(Math.floor(to.x), Math.floor(to.y));
  };
  const keyed = (event) => {
    const way = KEYS[event.key];
    if (!values || !(way || ((event.key === "Enter" || event.key === " ") && cross))) return;
    event.preventDefault();
    if (!way) return places.onPlace(...cross);
    const size = [values.width_px, values.height_px];
    const step = event.shiftKey ? 1 : Math.max(1, Math.round(size[0] / 64));
    const from = cross ?? size.map((each) => Math.round(each / 2));
    put(from.map((each, at) => Math.min(size[at] - 1, Math.max(0, each + step * way[at]))));
  };
  const all = [...(places?.marks ?? []), cross && { x_px: cross[0], y_px: cross[1], kind: "cross" }].filter(Boolean);
  const mark = ({ x_px, y_px, label = "", kind = "click" }) => html`<g class=${`is-${kind}`}
    transform=${`translate(${x_px} ${y_px}) scale(${values.width_px / 100})`}>
    <path class="halo" d=${SHAPES[kind]} /><path d=${SHAPES[kind]} />${label && html`<text x="2.6" y="-1.6">${label}</text>`}</g>`;
  const stage = places && { tabindex: 0, role: "application", "aria-label": WAY, "data-first": "" };
  const said = values && [measured(values, unit), places ? "" : values.words, ...(values.remarks ?? [])];
  const kind = failed ? "is-wrong" : values?.words && !values.found ? "is-missing" : "";
  return html`<figure class="setup-picture">
    <div class=${`setup-stage-picture ${places ? "is-clickable" : ""}`} ...${stage}
      onpointerdown=${places && clicked} onkeydown=${places && keyed}>
      <${Photo} blob=${shown.blob} alt="What the camera sees" draggable=${false} />
      <svg class="setup-marks" aria-hidden="true" ref=${marks}
        viewBox=${values && `0 0 ${values.width_px} ${values.height_px}`}>${values && all.map(mark)}</svg></div>
    <figcaption><p class=${`setup-caption quiet small ${kind}`} role="status">
      ${failed ?? said?.filter(Boolean).join(" ")}</p></figcaption>
  </figure>`;
}

const measured = ({ distance_m, sigma_m }, unit) =>
  distance_m === null || distance_m === undefined ? "" : `${distance(distance_m, sigma_m, unit).text}.`;
