// One stream of snapshots for the tab: what the run shows, each with its frame, and what has been since.

import { api } from "./api.js";
import { latest } from "./latest.js";

const HISTORY_S = 300;
const EVENTS_MAX = 500;
const RETRY_MS = [300, 1000, 2000, 5000];
// A run that is well tells something every 300 ms at least; it is checked every 100 ms, so all is grey within a second.
const STALE_MS = 800;
// A device that lost its power ends no connection; also without a run it says so every few seconds.
const SILENT_MAX_MS = 20000;
const SILENT = "Nothing comes from the device any more. Is it on, and this phone in its network?";

/** `subscribe(fn(snapshot, bitmap|null), {image})` opens the stream and returns what ends it. A bitmap is good
 *  until the next call.
 *  `state` is `{status: "connecting"|"live"|"lost", words}`; `watch(fn)` is called when it changes. `history` has
 *  `samples` by target and `events`, newest first. `ageMs()` is how old the shown frame is now, `staleMs()` how old all
 *  the rest is, once it is too old to be taken for what is now. */
export class Live {
  #readers = new Map();
  #watchers = new Set();
  #stop = null;
  #kind = "";
  #failures = 0;
  #offset = null; // the quickest way of a snapshot in this connection so far: this tab's clock less the device's, ms
  #received = null; // of the newest frame: when, and how old it was then
  #bitmap = null;
  #heard = null; // of the newest message: when it came, and how old what it tells was then
  #clocks = -Infinity; // the device's time of day less the run's clock
  state = { status: "connecting", words: "" };
  snapshot = null;
  history = emptied();

  constructor() {
    document.addEventListener("visibilitychange", () => this.#adjust());
  }

  subscribe(fn, { image = true } = {}) {
    const key = Symbol("reader");
    this.#readers.set(key, { fn, image });
    if (this.snapshot) fn(this.snapshot, image && this.#kind === "plain" ? this.#bitmap : null);
    queueMicrotask(() => this.#adjust()); // once for all parts of a view, or the first would open a stream in vain
    return () => {
      this.#readers.delete(key);
      this.#adjust();
    };
  }

  watch(fn) {
    this.#watchers.add(fn);
    fn(this.state);
    return () => this.#watchers.delete(fn);
  }

  /** How old the newest frame is: when it arrived, what it waited for on its way, and the time since; null before the
   *  first. */
  ageMs() {
    return this.#received && performance.now() - this.#received.at + this.#received.age;
  }

  /** How old the figures are that are shown, if they are not of now: the run is lost, or its loop or the way to here
   *  stands still. Else null, also while nothing is shown. Measured by this tab's own clock. */
  staleMs() {
    if (!this.snapshot) return null;
    const age = performance.now() - this.#heard.at + this.#heard.age;
    return age > STALE_MS || this.state.status === "lost" ? age : null;
  }

  /** Ask again at once, as after a start of the run. */
  retry() {
    this.#kind = "";
    this.#adjust();
  }

  #adjust() {
    const wanted = [...this.#readers.values()];
    const kind = !wanted.length || document.hidden ? "" : wanted.some((each) => each.image) ? "plain" : "none";
    if (kind === this.#kind) return;
    this.#kind = kind;
    this.#stop?.abort();
    this.#stop = null;
    if (kind) this.#keepReading(kind, (this.#stop = new AbortController()));
  }

  async #keepReading(kind, stop) {
    while (!stop.signal.aborted) {
      const connection = new AbortController(); // ends with the stream, or when nothing comes through it
      const end = () => connection.abort();
      stop.signal.addEventListener("abort", end);
      try {
        const response = await answered(api.stream(`live?image=${kind}`, { signal: connection.signal }), connection);
        await this.#read(response.body.getReader(), connection);
        this.#tell("lost", "The run has ended.");
      } catch (error) {
        if (stop.signal.aborted) return;
        if (connection.signal.aborted) this.#tell("lost", SILENT, "offline");
        else this.#tell("lost", error.message, error.code);
      } finally {
        stop.signal.removeEventListener("abort", end);
      }
      await later(RETRY_MS[Math.min(this.#failures++, RETRY_MS.length - 1)], stop.signal);
    }
  }

  /** Takes what comes as fast as it comes, whatever the drawing costs: else it piles up in the browser, and ages. */
  async #read(reader, connection) {
    const messages = new Messages();
    this.#offset = null; // meanwhile a clock may have been set, or this device have slept
    for (;;) {
      const { done, value } = await answered(reader.read(), connection);
      if (done) return;
      for (const message of messages.add(value)) {
        const { gone, code } = message.snapshot;
        if (gone) this.#tell("lost", gone, code);
        else this.#take(message);
      }
    }
  }

  #take(message) {
    this.#remember(message.snapshot);
    message.at = performance.now();
    message.transit = this.#transit(message.snapshot, message.at);
    this.#heard = { at: message.at, age: message.transit + (message.snapshot.cycle_age_s ?? 0) * 1000 };
    this.#show(message);
  }

  #remember(snapshot) {
    if (snapshot.run?.started_unix_s !== this.snapshot?.run?.started_unix_s) {
      this.history = emptied();
      this.#offset = null;
    }
    this.snapshot = snapshot;
    for (const [target, fresh] of Object.entries(snapshot.samples ?? {})) {
      const kept = (this.history.samples[target] ??= []);
      const last = kept.at(-1)?.[0] ?? -Infinity;
      kept.push(...fresh.filter((sample) => sample[0] > last));
      const old = kept.findIndex((sample) => sample[0] >= snapshot.now_s - HISTORY_S);
      if (old > 0) kept.splice(0, old);
    }
    const newest = this.history.events[0]?.number ?? -Infinity;
    const fresh = (snapshot.events ?? []).filter((event) => event.number > newest).sort((a, b) => b.number - a.number);
    if (fresh.length) this.history.events = [...fresh, ...this.history.events].slice(0, EVENTS_MAX);
  }

  #show = latest(async (_, { snapshot, jpeg, at, transit }) => {
    const bitmap = jpeg.length
      ? await createImageBitmap(new Blob([jpeg], { type: "image/jpeg" })).catch(() => null)
      : null;
    if (snapshot.frame) this.#received = { at, age: transit + (snapshot.now_s - snapshot.frame.captured_at_s) * 1000 };
    this.#failures = 0;
    this.#tell("live", "");
    for (const { fn, image } of [...this.#readers.values()]) fn(snapshot, image ? bitmap : null);
    this.#bitmap?.close();
    this.#bitmap = bitmap;
  });

  /** How long a snapshot was on its way: with the page's process, and beyond the quickest so far; clocks drift, so the
   *  quickest is forgotten slowly. */
  #transit(snapshot, at) {
    const clocks = snapshot.unix_s - snapshot.now_s;
    if (clocks < this.#clocks - 1) this.#offset = null; // the time of day was set back
    this.#clocks = clocks;
    const waited = (snapshot.waited_s ?? 0) * 1000;
    const offset = at - waited - snapshot.unix_s * 1000;
    this.#offset = Math.min(offset, (this.#offset ?? offset) + 0.05);
    return waited + offset - this.#offset;
  }

  #tell(status, words, code = "") {
    if (status === this.state.status && words === this.state.words) return;
    this.state = { status, words, code };
    for (const fn of this.#watchers) fn(this.state);
  }
}

/** Cuts a stream into messages: length of the JSON, length of the JPEG (each 4 bytes, big-endian), JSON, JPEG. */
class Messages {
  #rest = new Uint8Array(0);

  add(bytes) {
    const all = new Uint8Array(this.#rest.length + bytes.length);
    all.set(this.#rest);
    all.set(bytes, this.#rest.length);
    const view = new DataView(all.buffer);
    const whole = [];
    let at = 0;
    while (at + 8 <= all.length) {
      const json = at + 8;
      const jpeg = json + view.getUint32(at);
      const end = jpeg + view.getUint32(at + 4);
      if (end > all.length) break;
      whole.push({
        snapshot: JSON.parse(new TextDecoder().decode(all.subarray(json, jpeg))),
        jpeg: all.slice(jpeg, end),
      });
      at = end;
    }
    this.#rest = all.slice(at);
    return whole;
  }
}

const emptied = () => ({ samples: {}, events: [] });

/** What is waited for, unless it takes too long: then the connection is given up. */
const answered = (promise, connection) => {
  const timer = setTimeout(() => connection.abort(), SILENT_MAX_MS);
  return promise.finally(() => clearTimeout(timer));
};

const later = (ms, signal) =>
  new Promise((done) => {
    const timer = setTimeout(done, ms);
    signal.addEventListener("abort", () => (clearTimeout(timer), done()), { once: true });
  });
