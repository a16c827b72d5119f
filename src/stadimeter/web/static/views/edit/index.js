// The configuration as text: problems and meaning while one types, what it would have done, saving, versions.

import { ask } from "../../dialog.js";
import { differenceView } from "../../difference.js";
import { h, replace, write } from "../../dom.js";
import { latest } from "../../latest.js";
import { html, render } from "../../ui.js";
import { Editor } from "./editor.js";
import { Meaning } from "./problems.js";
import { Saving } from "./saving.js";
import { Trying } from "./trying.js";
import { Versions } from "./versions.js";

const PAUSE_MS = 250; // since the last key

/** Show the view in `root`; returns what takes it down. */
export function mount(root, { api, say, unit }) {
  const desk = new Desk(root, api, say, unit);
  desk.load();
  return () => desk.close();
}

class Desk {
  constructor(root, api, say, unit) {
    Object.assign(this, { root, api, say, unit, base: { text: "", version: "" }, path: "" });
    this.editor = new Editor("Configuration, as TOML", () => this.#changed());
    this.meaning = h("div");
    this.saving = new Saving(this);
    this.trying = new Trying(this);
    this.versions = h("div");
    this.state = h("p", { class: "quiet grow", role: "status" });
    this.save = h("button", { type: "button", class: "button primary", onclick: () => this.#save() }, "Save");
    this.discard = h("button", { type: "button", class: "button", onclick: () => this.#discard() }, "Discard changes");
    this.changes = h(
      "details",
      { class: "changes", ontoggle: () => this.#showChanges() },
      h("summary", {}, "What you changed"),
      h("div"),
    );
    this.leaving = (event) => this.isChanged && event.preventDefault();
    window.addEventListener("beforeunload", this.leaving);
  }

  get isChanged() {
    return this.editor.text !== this.base.text;
  }

  async load() {
    try {
      const { text, version, path, versions } = await this.api.get("configuration");
      Object.assign(this, { path, base: { text, version } });
      this.#draw();
      const draft = keptDraft(path);
      if (draft) this.base = draft.base;
      this.editor.text = draft?.text ?? text;
      this.#changed();
      this.#showVersions(versions);
      this.trying.load();
      if (draft)
        this.say(
          draft.base.version === version
            ? "Your text from before is here. It is not saved."
            : "Your text from before is here. The saved configuration has changed since: saving will show you how.",
          "warning",
        );
    } catch (error) {
      replace(this.root, h("p", { class: "banner is-error" }, error.message));
    }
  }

  close() {
    clearTimeout(this.timer);
    this.check.end();
    this.trying.stop();
    window.removeEventListener("beforeunload", this.leaving);
  }

  /** Show problems that a refusal came with. */
  show(problems) {
    this.#checked({ problems: problems.map((each) => ({ severity: "error", ...each })) });
  }

  /** What the editor held was saved. */
  async saved({ version }, text) {
    this.base = { text, version };
    this.#changed();
    this.say("Saved.");
    await this.#refresh();
  }

  /** Go on from what is saved now. */
  use({ text, version }) {
    this.base = { text, version };
    this.editor.text = text;
    this.#changed();
  }

  async restored(answer) {
    await this.#refresh((now) => this.use(now));
    this.saving.offer(answer);
  }

  async #refresh(use = () => {}) {
    try {
      const now = await this.api.get("configuration");
      use(now);
      this.#showVersions(now.versions);
    } catch (error) {
      this.say(error.message, "error");
    }
  }

  #showVersions = (versions) => render(html`<${Versions} versions=${versions} desk=${this} />`, this.versions);

  /** Ask what a text means; the newest one is asked about at once. */
  check = latest(
    async (signal, text, options = {}) => {
      try {
        this.#checked(await this.api.post("configuration/check", { text, ...options }, { signal }), options.tests);
      } catch (error) {
        if (!signal.aborted) this.#showMeaning({ failed: error.message });
      }
    },
    { calls_off: true },
  );

  #checked(answer, isTested = false) {
    const problems = answer.problems.map((each) => ({
      ...each,
      isElsewhere: Boolean(each.file) && each.file !== this.path,
    }));
    this.editor.show(problems.filter((each) => !each.isElsewhere));
    this.#showMeaning({ ...answer, problems, tests: isTested ? answer.tests : null });
  }

  #showMeaning(answer) {
    const goTo = (line, column) => this.editor.goTo(line, column);
    const test = () => this.check(this.editor.text, { tests: true });
    render(html`<${Meaning} answer=${answer} goTo=${goTo} test=${test} />`, this.meaning);
  }

  async #save() {
    this.save.disabled = true;
    await this.saving.save();
    this.#changed();
  }

  async #discard() {
    const words = "The field shows what is saved. Undo brings your text back.";
    if (await ask({ title: "Discard your changes?", words, action: "Discard" })) this.editor.text = this.base.text;
  }

  #changed() {
    keepDraft(this.path, this.editor.text, this.base);
    write(this.state, this.isChanged ? "Not saved." : "As saved.");
    this.save.disabled = this.discard.disabled = !this.isChanged;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.check(this.editor.text), PAUSE_MS);
    this.trying.changed();
    this.#showChanges();
  }

  #showChanges() {
    if (this.changes.open)
      replace(
        this.changes.lastChild,
        differenceView(this.base.text, this.editor.text, "What you changed") ?? h("p", { class: "quiet" }, "Nothing."),
      );
  }

  #draw() {
    this.#showMeaning(null);
    replace(
      this.root,
      h(
        "div",
        { class: "edit" },
        h(
          "section",
          { class: "panel stack", "aria-label": "Text" },
          h("h1", {}, "Configuration ", h("span", { class: "quiet small" }, this.path)),
          this.editor.element,
          h("div", { class: "row" }, this.state, this.discard, this.save),
          this.saving.element,
          this.changes,
        ),
        this.meaning,
        h("div", { class: "stack wide" }, this.trying.element, this.versions),
      ),
    );
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
function keepDraft(path, text, base) {
  try {
    if (text === base.text) sessionStorage.removeItem(KEY);
    else sessionStorage.setItem(KEY, JSON.stringify({ path, text, base }));
  } catch {
    // A browser that keeps nothing: the text is still on the page, which asks before it is left.
  }
}
