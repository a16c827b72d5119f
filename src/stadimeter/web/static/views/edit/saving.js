// Saving, and what follows it: two who save at once, a text with errors, and a run that must reload or restart.

import { ask } from "../../dialog.js";
import { differenceView } from "../../difference.js";
import { button, h, replace } from "../../dom.js";

const APPLY = {
  reload: { path: "run/reload", words: "Reload the run", why: "The run can take the new rules without a stop." },
  restart: {
    path: "run/restart",
    words: "Restart the run",
    why: "The run must restart for this change. Its outputs go to their safe values meanwhile.",
  },
  start: { path: "run/start", words: "Start the run", why: "No run uses this configuration now." },
};

/** Saves what the editor holds. `desk` is the view: its `editor`, `api`, `say`, `base` (what the text began from) and
 *  `saved(answer, text)`. */
export class Saving {
  constructor(desk) {
    this.desk = desk;
    this.element = h("div", { class: "stack", role: "status" });
  }

  async save(options = {}) {
    const { desk } = this;
    const text = desk.editor.text;
    try {
      const answer = await desk.api.put("configuration", { text, base_version: desk.base.version, ...options });
      await desk.saved(answer, text);
      this.offer(answer);
    } catch (error) {
      await this.#refused(error, options).catch(({ message }) => desk.say(message, "error"));
    }
  }

  async #refused(error, options) {
    if (error.code === "conflict") await this.#conflict();
    else if (error.problems?.length) await this.#wrong(error, options);
    else throw error;
  }

  /** Say what is needed for the run to use what was saved, and do it on a button. A view that shows thresholds asks for
   *  them anew. */
  offer({ needs }) {
    this.desk.loadMarks?.();
    const { path, words, why } = APPLY[needs] ?? { why: "The run goes by it already." };
    replace(
      this.element,
      h(
        "section",
        { class: "panel stack", "aria-label": "Saved" },
        h("p", {}, h("strong", {}, "Saved. "), why),
        path &&
          h(
            "div",
            { class: "row" },
            button(words, () => this.#apply(path), "primary"),
            button("Not now", () => replace(this.element)),
          ),
      ),
    );
  }

  async #apply(path) {
    try {
      const answer = await this.desk.api.post(path);
      replace(this.element);
      this.desk.say(
        answer?.words ?? (answer?.changed?.length ? `Done; changed: ${answer.changed.join(", ")}.` : "Done."),
      );
    } catch (error) {
      this.desk.say(error.message, "error");
    }
  }

  async #wrong(error, options) {
    const { desk } = this;
    desk.show(error.problems);
    const why = "A run that starts with it stops at once and says why. The run that goes on now is not touched.";
    if (await ask({ title: "Save it with its errors?", words: `${error.message} ${why}`, action: "Save all the same" }))
      await this.save({ ...options, even_if_wrong: true });
  }

  /** Another saved since: show what they changed, and let the person choose. Nothing is lost either way. */
  async #conflict() {
    const { desk } = this;
    const theirs = await desk.api.get("configuration");
    const changes = differenceView(desk.base.text, theirs.text, "What was changed meanwhile");
    const keepMine = async () => {
      desk.base = { text: theirs.text, version: theirs.version };
      await this.save();
    };
    const takeTheirs = () => {
      desk.use(theirs);
      replace(this.element);
      desk.say("Their text is in the field. Undo brings yours back.");
    };
    replace(
      this.element,
      h(
        "section",
        { class: "panel stack", "aria-label": "Changed meanwhile" },
        h("h2", {}, "Someone else saved this configuration since you opened it"),
        h("p", {}, "Nothing was saved. Your text is still in the field. They changed:"),
        changes ?? h("p", {}, "Their text is the one that you began with."),
        h(
          "div",
          { class: "row" },
          button("Save mine in place of theirs", keepMine, "primary"),
          button("Use theirs", takeTheirs),
        ),
        h("p", { class: "quiet" }, "The text that is replaced is kept among the versions below."),
      ),
    );
    this.element.scrollIntoView({ block: "nearest" });
  }
}
