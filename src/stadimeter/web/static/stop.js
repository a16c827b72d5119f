// Stop: sent at once, sent again until it is confirmed, and if it is not, what to do by hand.

import { h, write } from "./dom.js";
import { html, Icon, render } from "./ui.js";

const AGAIN_MS = 1000; // TCP sends a lost packet again within a second; a request that hangs for longer hangs for good
const GIVE_UP_MS = 5000;
const GOOD_MS = 6000;
const BY_HAND = "Not confirmed: the outputs may still act. Cut their supply by hand.";

/** Return the button and what became of it. It never becomes the button that releases: two presses are one stop. */
export function stopButton(api) {
  const words = h("p", { class: "said", role: "alert", hidden: true });
  const props = { type: "button", class: "button danger", "aria-label": "Stop every output", onclick: press };
  let sending = new AbortController();
  let hiding = 0;

  function show(text, kind) {
    clearTimeout(hiding);
    words.className = `said is-${kind}`;
    words.hidden = false;
    write(words, text);
    if (kind === "good") hiding = setTimeout(() => (words.hidden = true), GOOD_MS);
  }

  function press() {
    sending.abort();
    sending = new AbortController();
    const { signal } = sending;
    const begun = performance.now();
    let reason = "";
    show("Sending …", "warning");
    send();
    const timer = setInterval(() => {
      if (performance.now() - begun < GIVE_UP_MS) {
        show("Not confirmed yet, sending again …", "warning");
        send();
      } else {
        clearInterval(timer); // what is under way may still be answered
        show(`${BY_HAND} ${reason}`, "error");
      }
    }, AGAIN_MS);
    signal.addEventListener("abort", () => clearInterval(timer));

    async function send() {
      try {
        const by = localStorage.getItem("name") || undefined;
        const answer = await api.post("outputs/stop", { by }, { signal, priority: "high" });
        if (signal.aborted) return;
        sending.abort(); // or one that is late would stop again what was released meanwhile
        show(answer.words, answer.unconfirmed.length ? "error" : "good");
      } catch (error) {
        reason = error.message;
      }
    }
  }

  const button = h("button", props);
  render(html`<${Icon} name="stop" />Stop`, button);
  return [button, words];
}
