// The configuration as text: problems and meaning while one types, what it would have done, saving, versions.

import { api } from "../../api.js";
import { ask } from "../../dialog.js";
import { Difference } from "../../difference.js";
import { latest } from "../../latest.js";
import { Button, html, Model, useEffect, useModel, useState } from "../../ui.js";
import { Editor } from "./editor.js";
import { Meaning } from "./problems.js";
import { Conflict, Saved } from "./saving.js";
import { Trying } from "./trying.js";
import { Versions } from "./versions.js";

const PAUSE_MS = 250; // since the last key

export function View(context) {
  const desk = useModel(Desk, context);
  useEffect(() => void desk.load(), []);
  const { failed, path, text, base, answer, below, hand, isChanged } = desk;
  if (failed || !path)
    return html`<h1>Configuration</h1><p class=${failed ? "banner is-error" : "quiet"}>${failed || "Loading …"}</p>`;
  return html`<div class="edit">
    <section class="panel stack" aria-label="Text">
      <h1>Configuration <span class="quiet small">${path}</span></h1>
      <${Editor} label="Configuration, as TOML" text=${text} hand=${hand} onchange=${desk.changed}
        problems=${answer?.problems?.filter(({ isElsewhere }) => !isElsewhere) ?? []} />
      <div class="row"><p class="quiet grow" role="status">${isChanged ? "Not saved." : "As saved."}</p>
        <${Button} disabled=${!isChanged} onclick=${() => desk.discard()}>Discard changes<//>
        <${Button} kind="primary" disabled=${!isChanged || desk.isSaving} onclick=${() => desk.save()}>Save<//></div>
      <div class="stack" role="status">${below}</div>
      <${Changes} before=${base.text} after=${text} />
    </section>
    <${Meaning} answer=${answer} goTo=${hand.goTo} test=${() => desk.check(text, { tests: true })} />
    <div class="stack wide"><${Trying} desk=${desk} /><${Versions} desk=${desk} /></div>
  </div>`;
}

function Changes(texts) {
  const [isOpen, open] = useState(false);
  const label = "What you changed";
  return html`<details class="changes" ontoggle=${(event) => open(event.currentTarget.open)}><summary>${label}</summary>
    ${isOpen && html`<${Difference} ...${texts} label=${label} none="Nothing." />`}</details>`;
}

/** The text in the field, and `base`, which it began from. */
class Desk extends Model {
  text = "";
  base = { text: "", version: "" };
  path = "";
  versions = [];
  answer = null; // of the check
  below = null; // what is to be said or chosen after a save
  hand = {}; // of the field; see `Editor`

  get isChanged() {
    return this.text !== this.base.text;
  }

  asks = (event) => this.isChanged && event.preventDefault(); // before the tab is left

  async load() {
    window.addEventListener("beforeunload", this.asks);
    try {
      const { text, version, path, versions } = await api.get("configuration");
      const draft = keptDraft(path);
      this.put({ path, versions, base: draft?.base ?? { text, version } });
      this.changed(draft?.text ?? text);
      if (!draft) return;
      const since =
        draft.base.version === version
          ? "It is not saved."
          : "The saved configuration has changed since: saving will show you how.";
      this.say(`Your text from before is here. ${since}`, "warning");
    } catch (error) {
      this.put({ failed: error.message });
    }
  }

  leave() {
    clearTimeout(this.timer);
    this.check.end();
    window.removeEventListener("beforeunload", this.asks);
  }

  changed = (text) => {
    this.put({ text });
    keepDraft(this);
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.check(text), PAUSE_MS);
  };

  /** Ask what a text means; the newest one is asked about at once. */
  check = latest(
    async (signal, text, options = {}) => {
      try {
        const { tests, ...answer } = await api.post("configuration/check", { text, ...options }, { signal });
        this.show({ ...answer, tests: options.tests ? tests : null });
      } catch (error) {
        if (!signal.aborted) this.put({ answer: { failed: error.message } });
      }
    },
    { calls_off: true },
  );

  /** Show what a check found, or the problems that a refusal came with. */
  show({ problems, ...answer }) {
    const found = problems.map((each) => ({
      severity: "error",
      ...each,
      isElsewhere: Boolean(each.file) && each.file !== this.path,
    }));
    this.put({ answer: { ...answer, problems: found } });
  }

  async save(options = {}) {
    const { text, base } = this;
    this.put({ isSaving: true });
    try {
      const answer = await api.put("configuration", { text, base_version: base.version, ...options });
      this.put({ base: { text, version: answer.version } });
      keepDraft(this);
      await this.saved(answer);
    } catch (error) {
      await this.#refused(error, options).catch(({ message }) => this.say(message, "error"));
    }
    this.put({ isSaving: false });
  }

  async #refused(error, options) {
    if (error.code === "conflict") return this.#differs(await api.get("configuration"));
    if (!error.problems?.length) throw error;
    this.show(error);
    const why = "A run that starts with it stops at once and says why. The run that goes on now is not touched.";
    const words = `${error.message} ${why}`;
    if (await ask({ title: "Save it with its errors?", words, action: "Save all the same" }))
      await this.save({ ...options, even_if_wrong: true });
  }

  #differs(theirs) {
    const keepMine = () => {
      this.base = theirs;
      return this.save();
    };
    const takeTheirs = () => {
      this.put({ below: null });
      this.use(theirs);
      this.say("Their text is in the field. Undo brings yours back.");
    };
    const ways = { keepMine, takeTheirs };
    this.put({ below: html`<${Conflict} base=${this.base} theirs=${theirs} ...${ways} />` });
  }

  /** Say that it was saved and what the run needs, and list the versions anew; `use(now)` takes what is saved now. */
  async saved(answer, use = (_now) => {}) {
    this.put({ below: html`<${Saved} key=${answer.version} ...${answer} say=${this.say} />` });
    this.say("Saved.");
    try {
      const now = await api.get("configuration");
      use(now);
      this.put({ versions: now.versions });
    } catch (error) {
      this.say(error.message, "error");
    }
  }

  /** Go on from what is saved now. */
  use = ({ text, version }) => {
    this.base = { text, version };
    this.hand.put(text);
  };

  async discard() {
    const words = "The field shows what is saved. Undo brings your text back.";
    if (await ask({ title: "Discard your changes?", words, action: "Discard" })) this.hand.put(this.base.text);
  }
}

// The text that is not saved yet, and what it began from: kept in the tab, so that a reload of the page loses nothing.

const KEY = "stadimeter.draft";

/** The kept draft of this configuration: `{path, text, base}`, or null. */
function keptDraft(path) {
  try {
    const draft = JSON.parse(sessionStorage.getItem(KEY));
    return draft?.path === path ? draft : null;
  } catch {
    return null;
  }
}

/** Keep a draft; one that is as saved is forgotten. */
function keepDraft({ path, text, base }) {
  try {
    if (text === base.text) sessionStorage.removeItem(KEY);
    else sessionStorage.setItem(KEY, JSON.stringify({ path, text, base }));
  } catch {
    // A browser that keeps nothing: the text is still on the page, which asks before it is left.
  }
}
