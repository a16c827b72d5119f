// What components of the page share: htm with Preact, buttons, signs, and the newest snapshot of the run.

import { html, render, useEffect, useLayoutEffect, useReducer, useRef, useState } from "./vendor/preact/preact.js";

export { html, render, useEffect, useLayoutEffect, useReducer, useRef, useState };

/** A button of words; `label` is its name where the words alone would not say what it is of. */
export const Button = ({ kind = "", label, children, ...rest }) =>
  html`<button type="button" class=${`button ${kind}`.trim()} aria-label=${label} ...${rest}>${children}</button>`;

/** Names in backquotes, as the terminal prints them, in the type of code. */
export const inCode = (text) => text.split("`").map((part, at) => (at % 2 ? html`<code>${part}</code>` : part));

/** A drawn sign beside words; it says nothing by itself. */
export const Icon = ({ name }) =>
  html`<svg class="icon" viewBox="0 0 24 24" aria-hidden="true"><path d=${ICONS[name]} /></svg>`;

const ICONS = {
  live: "M3 12h4l3-8 4 16 3-8h4",
  timeline: "M3 20h18M3 16l5-6 4 4 5-9 4 5",
  setup: "M12 8.5a3.5 3.5 0 1 0 0 7 3.5 3.5 0 0 0 0-7M12 2v4M12 18v4M2 12h4M18 12h4",
  edit: "M4 20h4L19 9l-4-4L4 16zM13 7l4 4",
  recordings: "M4 5h16v14H4zM10 9v6l5-3z",
  alarms: "M6 17V11a6 6 0 0 1 12 0v6l2 2H4zM10 21h4",
  close: "M6 6l12 12M18 6L6 18",
  stop: "M8.5 3h7L21 8.5v7L15.5 21h-7L3 15.5v-7zM9 9h6v6H9z",
};

/** A state by its shape and colour, with its word. */
export const Badge = ({ kind, children }) => html`<span class=${`badge is-${kind}`}>${children}</span>`;

/** The newest snapshot of the run; draws again when one comes, at most as often as is said, and when the run is lost. */
export function useSnapshot(live, every_ms = 200) {
  const [, draw] = useReducer((count) => count + 1, 0);
  useLayoutEffect(() => {
    let last_ms = Number.NEGATIVE_INFINITY;
    const fresh = () => {
      if (performance.now() - last_ms < every_ms) return;
      last_ms = performance.now();
      draw();
    };
    const leave = [live.subscribe(fresh, { image: false }), live.watch(draw)];
    return () => leave.forEach((each) => each());
  }, [live, every_ms]);
  return live.snapshot;
}

/** A choice that this browser remembers, the same wherever it is asked for: `[value, choose]`. */
export function useKept(key, otherwise) {
  const [, draw] = useReducer((count) => count + 1, 0);
  useEffect(() => {
    const changed = (/** @type {any} */ { detail }) => detail === key && draw();
    window.addEventListener("kept", changed);
    return () => window.removeEventListener("kept", changed);
  }, [key]);
  const choose = (chosen) => {
    localStorage.setItem(key, chosen);
    window.dispatchEvent(new CustomEvent("kept", { detail: key }));
  };
  return [localStorage.getItem(key) ?? otherwise, choose];
}

/** What a view holds and does. It has what it is given at first; `put(changed)` changes it, and draws the view anew.
 *  @type {any} */
export const Model = class {
  constructor(given) {
    Object.assign(this, given);
  }

  put(changed) {
    Object.assign(this, changed);
    /** @type {any} */ (this).draw();
  }

  /** End what it began. */
  leave() {}
};

/** The model of a view, of a class of its own. */
export function useModel(Kind, given) {
  const [, draw] = useReducer((count) => count + 1, 0);
  const kept = useRef(null);
  kept.current ??= new Kind({ draw, ...given });
  useEffect(() => () => kept.current.leave(), []);
  return kept.current;
}

/** Ask again and again while the page is seen: `ask(signal)` shows what it brings, `failed(error)` what went wrong. */
export function useAgain(ask, failed, isWanted = true) {
  const newest = useRef();
  newest.current = { ask, failed };
  useEffect(() => {
    const stop = new AbortController();
    const next = async () => {
      if (stop.signal.aborted) return;
      let pause_ms = PAUSE_MS;
      try {
        if (!document.hidden) await newest.current.ask(stop.signal);
      } catch (error) {
        if (!stop.signal.aborted) await newest.current.failed(error);
        pause_ms = AGAIN_MS;
      }
      setTimeout(next, pause_ms);
    };
    if (isWanted) next();
    return () => stop.abort();
  }, [isWanted]);
}

const PAUSE_MS = 60;
const AGAIN_MS = 1500;

/** A picture that an answer brought. */
export function Photo({ blob, ...rest }) {
  const image = useRef();
  useLayoutEffect(() => {
    if (!blob?.size) return;
    image.current.src = URL.createObjectURL(blob);
    return () => URL.revokeObjectURL(image.current?.src ?? "");
  }, [blob]);
  return html`<img ref=${image} hidden=${!blob?.size} ...${rest} />`;
}

/** A choice of words by value: `options` is `{value: words}`. */
export function Select({ options, value, choose, ...rest }) {
  const option = ([each, words]) => html`<option value=${each} selected=${each === value}>${words}</option>`;
  return html`<select onchange=${(event) => choose?.(event.target.value)} ...${rest}>
    ${Object.entries(options).map(option)}</select>`;
}

/** A label above what it is of. */
export const Field = ({ label, children }) => html`<label class="field"><span>${label}</span>${children}</label>`;

/** A panel that is folded until it is wanted, which this browser remembers. What is folded is not drawn. */
export function Fold({ name, title, said = "", isOpen = false, children }) {
  const [open, keep] = useKept(`fold ${name}`, isOpen ? "yes" : "no");
  const toggled = ({ currentTarget }) => keep(currentTarget.open ? "yes" : "no");
  return html`<section class=${`panel fold ${name}`}>
    <details open=${open === "yes"} ontoggle=${toggled}>
      <summary><h2>${title}</h2><span class="small quiet">${said}</span></summary>
      ${open === "yes" && children}
    </details>
  </section>`;
}
