// A button that does something only while it is held: it asks again and again, and the device lets go 0.5 s after the
// last time.

import { h } from "./dom.js";

const BEAT_MS = 150;
const SLOW_MS = 450; // an answer that takes longer comes too late to go on holding

/** `send()` asks once and resolves to words; `release()` lets go. Pointer, touch, space and enter.
 *  It ends when it is let go, loses the focus, or the page is left, hidden or cut off. */
export function holdButton({ label, held = label, title, send, release, onWords = () => {} }) {
  let hold = null;
  const button = h("button", { type: "button", class: "button hold", title, "aria-pressed": "false" }, label);

  const begin = () => {
    if (hold || button.disabled) return;
    hold = { asked: Promise.resolve(), isWaiting: false };
    button.setAttribute("aria-pressed", "true");
    button.firstChild.data = held;
    beat();
    hold.timer = setInterval(beat, BEAT_MS);
  };
  const beat = () => {
    const mine = hold;
    if (!mine || mine.isWaiting) return; // one at a time: none may arrive after it was let go
    mine.isWaiting = true;
    const late = setTimeout(() => hold === mine && end("The connection is too slow to hold an output."), SLOW_MS);
    mine.asked = send()
      .then(
        (words) => hold === mine && onWords(words ?? ""),
        (error) => hold === mine && end(error.message),
      )
      .finally(() => (clearTimeout(late), (mine.isWaiting = false)));
  };
  const end = (words = "") => {
    if (!hold) return;
    const { timer, asked } = hold;
    hold = null;
    clearInterval(timer);
    button.setAttribute("aria-pressed", "false");
    button.firstChild.data = label;
    onWords(words);
    asked.then(release).catch(() => {}); // the device lets go by itself
  };

  button.addEventListener("pointerdown", (event) => {
    if (event.button) return;
    button.setPointerCapture(event.pointerId);
    begin();
  });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture", "blur"])
    button.addEventListener(name, () => end());
  button.addEventListener("contextmenu", (event) => event.preventDefault()); // a long touch
  button.addEventListener("keydown", (event) => {
    if (event.key !== " " && event.key !== "Enter") return end();
    event.preventDefault();
    if (!event.repeat) begin(); // what has ended begins with a new press only, as under a finger
  });
  button.addEventListener("keyup", () => end());
  const away = new AbortController();
  for (const [target, name] of [
    [document, "visibilitychange"],
    [window, "blur"],
    [window, "pagehide"],
  ]) {
    target.addEventListener(name, () => end(), { signal: away.signal });
  }
  button.takeDown = () => (end(), away.abort());
  return button;
}
