// Save: what would be written and what changes, what `check` and the tests say; then save it, and run it.

import { api } from "../../api.js";
import { Difference } from "../../difference.js";
import { Button, html, inCode, useEffect, useState } from "../../ui.js";

export function Save({ setup }) {
  const [made, show] = useState(null); // `{files, words, findings, tests, there}`
  const [failed, say] = useState("");
  const [isBusy, wait] = useState(false);
  const load = async (words = "") => {
    say(words);
    try {
      show({ ...(await api.post("setup/files")), there: await api.get("configuration") });
    } catch (error) {
      show(null);
      say(error.message);
    }
  };
  useEffect(() => void load(), []);
  const save = async (runs) => {
    wait(true);
    try {
      await saved(setup, made, runs);
    } catch (error) {
      if (error.code === "conflict")
        await load(
          `${error.message}. Below is what yours changes in theirs; save again to go on with yours. ` +
            "Theirs is kept as a former version.",
        );
      else say(error.message);
    }
    wait(false);
  };
  const back = html`<${Button} onclick=${() => setup.back()}>Back<//>`;
  const said = failed && html`<div class="setup-error" role="alert">${failed}</div>`;
  if (!made)
    return html`<div class="panel stack">${said || html`<p class="quiet">Writing it, and trying its tests …</p>`}
      <div class="row">${back}${failed && html`<${Button} onclick=${() => load()}>Try again<//>`}</div></div>`;
  const [configuration, ...others] = made.files;
  const isOff = isBusy || made.findings.some(({ severity }) => severity === "error");
  return html`<div class="panel stack">
    <${List} title="What it does" kind="setup-words" of=${made.words.map((each) => html`<li>${inCode(each)}</li>`)} />
    <${List} title="What was found in it" kind="setup-findings" of=${made.findings.map(finding)} />
    <${Tests} tests=${made.tests} />
    ${said}
    <div class="row setup-way">${back}
      <${Button} disabled=${isOff} onclick=${() => save(false)}>Save only<//>
      <${Button} kind="primary" disabled=${isOff} onclick=${() => save(true)}>Save, and run it<//></div>
    <${Configuration} ...${configuration} there=${made.there} />
    ${others.map((each) => html`<details><summary>${each.name}</summary><${File} ...${each} /></details>`)}
  </div>`;
}

/** Save, let go of the camera, and have the run go by it: started, reloaded or restarted, as the answer says. */
async function saved(setup, { files, there }, runs) {
  const { context } = setup;
  const [configuration, ...others] = files;
  const { needs } = await api.put("configuration", {
    text: configuration.text,
    base_version: there.version,
    files: Object.fromEntries(others.map(({ name, text }) => [name, text])),
  });
  if (!runs) return context.say("It is saved. The run goes by it when it is started, or reloaded.");
  setup.put({ isLooking: false }); // it would take the camera again
  await api.post("setup/leave", { camera_only: true });
  try {
    if (needs !== "nothing") await api.post(`run/${needs}`);
    await api.post("setup/leave");
  } catch (error) {
    setup.put({ isLooking: true });
    throw Object.assign(error, { message: `It is saved, but it does not run: ${error.message}` });
  }
  context.say("It is saved, and runs.");
  context.live.retry();
  location.hash = "live";
}

const List = ({ title, kind, of }) =>
  of.length > 0 && html`<section><h2>${title}</h2><ul class=${kind}>${of}</ul></section>`;

const finding = ({ severity, message, line, hint }) => html`<li class=${severity === "error" ? "is-wrong" : ""}>
  <b>${severity === "error" ? "Error" : "Warning"}${line ? `, line ${line}` : ""}:${" "}</b>${inCode(message)}
  ${hint && html`<span class="quiet">${" "}(${inCode(hint)})</span>`}</li>`;

function Tests({ tests }) {
  const failed = tests.filter(({ ok }) => !ok).length;
  const title = failed ? `${failed} of ${tests.length} tests fail` : `All ${tests.length} tests pass`;
  const test = ({ name, ok, words }) => html`<li class=${ok ? "is-good" : "is-wrong"}>
    <span aria-hidden="true">${ok ? "✓ " : "✗ "}</span>${name}<span class="sr">${ok ? ": passes" : ": fails"}</span>
    ${!ok && html`<span>: ${words}</span>`}</li>`;
  return html`<${List} title=${title} kind="setup-tests" of=${tests.map(test)} />`;
}

function Configuration({ name, text, there }) {
  const changes = "What changes in the configuration";
  const isSame = there.exists && there.text === text;
  if (isSame || !there.exists) {
    const title = isSame ? "The configuration is as it was" : `The configuration: ${name}`;
    return html`<details><summary>${title}</summary><${File} name=${name} text=${text} /></details>`;
  }
  return html`<details open><summary>${changes}</summary>
    <${Difference} before=${there.text} after=${text} label=${changes} /></details>`;
}

const File = ({ name, text }) =>
  html`<pre class="setup-file" tabindex="0" role="group" aria-label=${name}>${text}</pre>`;
