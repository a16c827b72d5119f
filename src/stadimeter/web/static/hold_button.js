// A button that does something only while it is held: it asks again and again, and the device lets go 0.5 s after the
// last time.

import { Button, html, useEffect, useRef, useState } from "./ui.js";

const BEAT_MS = 150;
const SLOW_MS = 450; // an answer that takes longer comes too late to go on holding

/** `send()` asks once and resolves to words; `release()` lets go; `onWords(words)` hears of both. Pointer, touch, space
 *  and enter. It ends when it is let go, loses the focus, or the page is left, hidden or cut off. */
export function HoldButton({ label, held = label, title, ...given }) {
  const [isHeld, show] = useState(false);
  const hold = useRef(null);
  const newest = useRef();
  newest.current = given;

  const begin = () => {
    if (hold.current) return;
    hold.current = { asked: Promise.resolve(), isWaiting: false };
    show(true);
    beat();
    hold.current.timer = setInterval(beat, BEAT_MS);
  };
  const beat = () => {
    const mine = hold.current;
    if (!mine || mine.isWaiting) return; // one at a time: none may arrive after it was let go
    mine.isWaiting = true;
    const isMine = () => hold.current === mine;
    const late = setTimeout(() => isMine() && end("The connection is too slow to hold an output."), SLOW_MS);
    mine.asked = newest.current
      .send()
      .then(
        (words) => isMine() && newest.current.onWords(words ?? ""),
        (error) => isMine() && end(error.message),
      )
      .finally(() => (clearTimeout(late), (mine.isWaiting = false)));
  };
  const end = (words = "") => {
    if (!hold.current) return;
    const { timer, asked } = hold.current;
    hold.current = null;
    clearInterval(timer);
    show(false);
    newest.current.onWords(words);
    asked.then(newest.current.release).catch(() => {}); // the device lets go by itself
  };

  useEffect(() => {
    const away = new AbortController();
    const leave = () => end();
    document.addEventListener("visibilitychange", leave, { signal: away.signal });
    for (const name of ["blur", "pagehide"]) window.addEventListener(name, leave, { signal: away.signal });
    return () => (end(), away.abort());
  }, []);

  const pressed = (event) => {
    if (event.button) return;
    event.currentTarget.setPointerCapture(event.pointerId);
    begin();
  };
  const keyed = (event) => {
    if (event.key !== " " && event.key !== "Enter") return end();
    event.preventDefault();
    if (!event.repeat) begin(); // what has ended begins with a new press only, as under a finger
  };
  const letGo = () => end();
  return html`<${Button} kind="hold" title=${title} aria-pressed=${String(isHeld)} onpointerdown=${pressed}
    onpointerup=${letGo} onpointercancel=${letGo} onlostpointercapture=${letGo} onblur=${letGo}
    onkeydown=${keyed} onkeyup=${letGo} oncontextmenu=${(event) => event.preventDefault()}>
    ${isHeld ? held : label}<//>`;
}
