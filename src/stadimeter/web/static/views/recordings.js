// Recordings: make one, list, replay with a slider, download, delete.

import { ask } from "../dialog.js";
import { button, h, replace, write } from "../dom.js";
import * as format from "../format.js";
import { Replay } from "./replay.js";

/** Show the view in `root`; returns what takes it down. */
export function mount(root, context) {
  const view = new Recordings(context);
  replace(root, view.element);
  view.load();
  const leave = context.live.subscribe((snapshot) => view.update(snapshot), { image: false });
  const lost = context.live.watch(({ status }) => view.connected(status));
  return () => {
    leave();
    lost();
    view.replay?.close();
  };
}

class Recordings {
  constructor(context) {
    Object.assign(this, { context, canOperate: context.session.right === "operate", isRecording: false, replay: null });
    this.listedAgain_ms = Infinity; // when a clip under way is whole
    this.record = button("Record", () => this.#record(), "primary", { hidden: !this.canOperate });
    const keep = () => this.#order("recordings/clip", { by: localStorage.getItem("name") || undefined });
    this.keep = button("Save clip", keep, "", { hidden: !this.canOperate });
    this.now = h("p", { class: "grow", role: "status" });
    const orders = h("div", { class: "row" }, this.record, this.keep, this.now);
    this.folder = h("p", { class: "quiet small" });
    this.list = h("ul", { class: "list recordings" });
    this.player = h("div");
    this.element = h(
      "div",
      { class: "stack" },
      h("section", { class: "panel stack of-run", "aria-label": "Record" }, h("h1", {}, "Recordings"), orders),
      this.player,
      h("section", { class: "panel", "aria-label": "List" }, this.list, this.folder),
    );
  }

  async load() {
    try {
      const { recordings, folder, left_out } = await this.context.api.get("recordings");
      replace(
        this.list,
        recordings.length
          ? recordings.map((each) => this.#row(each))
          : h(
              "li",
              {},
              "There are none yet. A recording holds the pictures, what was measured in them, " +
                "and what the rules decided.",
            ),
      );
      this.#openNamed(recordings);
      write(this.folder, `In ${folder}.${left_out ? ` ${left_out} older ones are not listed.` : ""}`);
    } catch (error) {
      replace(this.list, h("li", {}, error.message));
    }
  }

  update({ recording }) {
    const was = this.isRecording;
    this.isRecording = Boolean(recording);
    write(this.record, this.isRecording ? "Stop recording" : "Record");
    write(
      this.now,
      recording
        ? `Recording: ${format.span(recording.seconds)}, ${format.size(recording.bytes)}.`
        : "A recording can be replayed here, and changed rules be tried on it.",
    );
    if (was !== this.isRecording || Date.now() > this.listedAgain_ms) {
      this.listedAgain_ms = Infinity;
      this.load();
    }
  }

  connected(status) {
    this.record.disabled = status !== "live";
    if (status === "lost") write(this.now, "There is no run to record now.");
  }

  async #record() {
    this.record.disabled = true;
    await this.#order("recordings", { do: this.isRecording ? "stop" : "start" });
    this.record.disabled = false;
  }

  async #order(path, body) {
    try {
      const { words, seconds } = await this.context.api.post(path, body);
      if (words) this.context.say(words);
      if (seconds) this.listedAgain_ms = Date.now() + 1000 * (seconds + 2); // it is finished within a second or so
    } catch (error) {
      this.context.say(error.message, "error");
    }
    this.load();
  }

  /** Open the recording that the address names, once, at its moment: `#recordings/NAME/SECONDS`. */
  #openNamed(recordings) {
    const [, name, at_s] = location.hash.split("/");
    const wanted = name && !this.wasOpened && recordings.find((each) => each.name === decodeURIComponent(name));
    if (!wanted || !this.canOperate) return;
    this.wasOpened = true;
    this.#open(wanted, Number(at_s) || 0);
  }

  #row(recording) {
    const { name, kind, seconds, bytes, unix_s, configuration, damage, is_growing, clip_of } = recording;
    const clip = clip_of && `${clip_of.source} ${clip_of.kind}: ${clip_of.reason}`;
    const facts = [
      clip,
      format.moment(unix_s),
      seconds === null ? "" : format.span(seconds),
      format.size(bytes),
      configuration,
      kind === "journal" ? "no pictures" : "",
    ];
    const button = (words, onclick) =>
      h("button", { type: "button", class: "button", "aria-label": `${words} ${name}`, onclick }, words);
    const path = `recordings/${encodeURIComponent(name)}`;
    const actions = [
      seconds > 0 && kind === "recording" && button("Replay", () => this.#open(recording)),
      !is_growing &&
        h(
          "a",
          { class: "button", href: `/api/v1/${path}`, download: name, "aria-label": `Download ${name}` },
          "Download",
        ),
      !is_growing && button("Delete", () => this.#delete(name, path)),
    ];
    return h(
      "li",
      {},
      h(
        "div",
        { class: "row" },
        h(
          "div",
          { class: "grow" },
          h("strong", {}, name),
          is_growing && h("span", { class: "badge is-alarm" }, "recording"),
          h("p", { class: "quiet" }, facts.filter(Boolean).join(" · ")),
        ),
        this.canOperate && h("div", { class: "row" }, actions),
      ),
      damage && h("p", { class: "damaged" }, `▲ Damaged: ${damage}`),
    );
  }

  #open(recording, at_s) {
    this.replay?.close();
    this.replay = new Replay(
      recording,
      this.context,
      () => {
        replace(this.player);
        this.replay = null;
      },
      at_s,
    );
    replace(this.player, this.replay.element);
    this.replay.slider.focus({ preventScroll: true });
    this.player.scrollIntoView({ block: "start" });
  }

  async #delete(name, path) {
    if (
      !(await ask({
        title: `Delete ${name}?`,
        words: "It is gone for good. Download it first if you may need it.",
        action: "Delete",
        isDangerous: true,
      }))
    )
      return;
    try {
      await this.context.api.del(path);
      if (this.replay?.name === name) this.replay.end();
      this.context.say(`${name} is deleted.`);
    } catch (error) {
      this.context.say(error.message, "error");
    }
    this.load();
  }
}
