// Stop: sent at once, sent again until it is confirmed, and if it is not, what to do by hand.

import { api } from "./api.js";
import { Button, html, Icon, render } from "./ui.js";

const AGAIN_MS = 1000; // TCP sends a lost packet again within a second; a request that hangs for longer hangs for good
const GIVE_UP_MS = 5000;
const GOOD_MS = 6000;
const BY_HAND = "Not confirmed: the outputs may still act. Cut their supply by hand.";

/** Draw the button and what became of it. It never becomes the button that releases: two presses are one stop. What it
 *  says is drawn within the click itself, however much else there is to draw. */
export function drawStop(root) {
  let sending = new AbortController();
  let hiding = 0;

  function show(words, kind) {
    clearTimeout(hiding);
    render(
      html`<${Button} kind="danger" label="Stop every output" onclick=${press}><${Icon} name="stop" />Stop<//>
        <p class=${`said is-${kind}`} role="alert" hidden=${!words}>${words}</p>`,
      root,
    );
    if (kind === "good") hiding = setTimeout(() => show("", ""), GOOD_MS);
  }

  function press() {
    sending.abort();
    const stop = new AbortController();
    sending = stop;
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
    stop.signal.addEventListener("abort", () => clearInterval(timer));

    async function send() {
      try {
        const by = localStorage.getItem("name") || undefined;
        const answer = await api.post("outputs/stop", { by }, { signal: stop.signal, priority: "high" });
        if (stop.signal.aborted) return;
        stop.abort(); // or one that is late would stop again what was released meanwhile
        show(answer.words, answer.unconfirmed.length ? "error" : "good");
      } catch (error) {
        reason = error.message;
      }
    }
  }

  show("", "");
}
