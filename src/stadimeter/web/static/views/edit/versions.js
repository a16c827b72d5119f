// The former versions of the configuration, and bringing one back.

import { ask } from "../../dialog.js";
import { differenceView } from "../../difference.js";
import { button, h, replace } from "../../dom.js";
import { moment } from "../../format.js";

/** `desk` is the view: its `api`, `say`, `base`, `editor` and `restored(answer)`. */
export class Versions {
  constructor(desk) {
    this.desk = desk;
    this.list = h("ul", { class: "list versions" });
    this.element = h(
      "section",
      { class: "panel", "aria-label": "Versions" },
      h("h2", {}, "Former versions"),
      this.list,
    );
  }

  show(versions) {
    if (versions.length)
      replace(
        this.list,
        versions.map((each) => this.#row(each)),
      );
    else replace(this.list, h("li", { class: "quiet" }, "None yet. Each save keeps the text that it replaces."));
  }

  #row({ id, unix_s, words }) {
    const difference = h("div");
    const title = moment(unix_s);
    const look = button("Compare", () => this.#look(id, look, difference), "", {
      "aria-expanded": "false",
      "aria-label": `Compare the version of ${title}`,
    });
    const named = { "aria-label": `Bring back the version of ${title}` };
    const bring = button("Bring back", () => this.#bring(id, title), "", named);
    return h(
      "li",
      { class: "stack" },
      h(
        "div",
        { class: "row" },
        h("div", { class: "grow" }, h("strong", {}, title), h("p", { class: "quiet" }, words)),
        look,
        bring,
      ),
      difference,
    );
  }

  async #look(id, look, difference) {
    const isOpen = look.getAttribute("aria-expanded") === "true";
    look.setAttribute("aria-expanded", String(!isOpen));
    if (isOpen) return replace(difference);
    try {
      const { text } = await this.desk.api.get(`configuration/versions/${encodeURIComponent(id)}`);
      const changes = differenceView(text, this.desk.editor.text, "From that version to the text in the field");
      replace(difference, changes ?? h("p", {}, "The text in the field is the same."));
    } catch (error) {
      this.desk.say(error.message, "error");
    }
  }

  async #bring(id, title) {
    const words = "It becomes the saved configuration. The one that is saved now is kept among the versions.";
    if (!(await ask({ title: `Bring back the version of ${title}?`, words, action: "Bring back" }))) return;
    try {
      this.desk.restored(
        await this.desk.api.post(`configuration/versions/${encodeURIComponent(id)}/restore`, {
          base_version: this.desk.base.version,
        }),
      );
    } catch (error) {
      this.desk.say(error.message, "error");
    }
  }
}
