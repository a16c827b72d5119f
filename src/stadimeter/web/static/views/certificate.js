// The certificate of the site: the target at taped distances, one after the other, and what came of it.

import { api } from "../api.js";
import { Button, Field, html, useEffect, useRef, useState } from "../ui.js";

const HOW = "Put the target at a distance, measured with a tape from the lens to its nearest point. Keep all still.";
const WATCHING = "Watching for some seconds: keep all still …";

export function View({ say }) {
  const [state, show] = useState(null);
  const [busy, wait] = useState("Reading the configuration …");
  const [failed, fail] = useState("");

  /** Ask something that answers with the state, and show that; after an error, the state as it is. */
  const ask = async (words, question) => {
    wait(words);
    try {
      show(await question());
    } catch (error) {
      say(error.message, "error");
      await api.get("certificate").then(show, (other) => fail(other.message));
    }
    wait("");
  };
  useEffect(() => void ask(busy, () => api.get("certificate")), []);
  const take = (body) => ask(WATCHING, () => api.post("certificate/take", body));
  const finish = () => ask("Writing …", () => api.post("certificate/finish"));
  return html`<div class="stack">
    <section class="panel stack"><h1>Certificate of the site</h1>
      ${failed && html`<p class="banner is-error">${failed}</p>`}
      ${busy && html`<p role="status">${busy}</p>`}
      ${!failed && !busy && html`<${Form} ...${state} take=${take} finish=${finish} />`}</section>
    ${state?.certificate && html`<${Certificate} ...${state.certificate} />`}
  </div>`;
}

function Form({ left_m, placements, take, finish }) {
  const [distance, sigma] = [useRef(), useRef()];
  const read = () => take({ distance: distance.current.value, sigma: sigma.current.value });
  const isEnough = placements.filter(({ is_read }) => is_read).length > 2;
  return html`<p>${HOW}</p>
    <div class="row">
      <${Field} label="Distance"><input ref=${distance} defaultValue=${left_m.length ? `${left_m[0]} m` : ""} /><//>
      <${Field} label="Known to ±"><input ref=${sigma} defaultValue="2 mm" /><//></div>
    <div class="row"><${Button} onclick=${read}>Measure<//></div>
    <${List} sentences=${placements.map(({ words }) => words)} />
    <div class="row">${isEnough && html`<${Button} onclick=${finish}>Write the certificate<//>`}</div>`;
}

const List = ({ sentences }) => html`<ul class="list">${sentences.map((each) => html`<li>${each}</li>`)}</ul>`;

const Certificate = ({ date, outdated, words, rules }) => html`<section class="panel stack"
  aria-label="Certificate"><h2>Measured ${date}</h2>
  ${outdated && html`<p class="banner is-warning">Out of date: ${outdated}.</p>`}
  ${words.map((each) => html`<p>${each}</p>`)}
  <${List} sentences=${rules} />
  <div class="row"><a href="/api/v1/certificate.html" target="_blank" class="button">To print</a></div>
</section>`;
