// The lens by a printed board: views are taken while a person moves it about, and what is still missing is told.

import { button, h, replace, write } from "../../dom.js";

const PAUSE_MS = 100;
const AGAIN_MS = 1500;

/** A section that opens: which board it is, then what is covered, and the lens that follows. */
export function boardWay(step) {
  const { setup, api, picture } = step;
  const kind = h(
    "select",
    { onchange: () => (charuco.hidden = kind.value !== "charuco") },
    h("option", { value: "chessboard" }, "Chessboard: inner corners count"),
    h("option", { value: "charuco" }, "ChArUco board: squares count"),
  );
  const count = (value, name) => h("input", { type: "number", min: 3, max: 60, value, "aria-label": name });
  const [columns, rows] = [count(9, "Columns"), count(6, "Rows")];
  const length = (value) => h("input", { type: "text", autocomplete: "off", value });
  const [square, marker, dictionary] = [length("25 mm"), length("18 mm"), length("4X4_50")];
  const charuco = h(
    "div",
    { class: "stack", hidden: true },
    named("Side of a marker", marker),
    named("Dictionary of the markers", dictionary),
  );
  const begin = h("button", { type: "button", class: "button", onclick: start }, "Begin");
  const take = button("Take this lens", finish, "primary", { disabled: true });
  const share = h("progress", { max: 1, value: 0, "aria-label": "Share of the picture that is covered" });
  const [words, sum, lens] = [
    h("p", { class: "setup-found", role: "status" }),
    h("p", { class: "small" }),
    h("p", null),
  ];
  const missing = h("ul", { class: "setup-words" });
  const progress = h(
    "div",
    { class: "stack", hidden: true },
    words,
    share,
    sum,
    h("div", null, h("p", { class: "quiet small" }, "Still wanted:"), missing),
    lens,
    h("div", { class: "row" }, take),
  );
  const error = h("p", { class: "setup-error", role: "alert", hidden: true });
  let session = 0; // of looking; zero for none
  setup.onLeave(stop);
  return h(
    "details",
    { class: "setup-by-board", ontoggle: (event) => event.target.open || stop(), onkeydown: entered },
    h("summary", null, "With a printed board, which gives the lens's distortion too"),
    h(
      "div",
      { class: "stack" },
      h(
        "p",
        { class: "quiet small" },
        "Hold it flat before the camera, and still for a moment in each place: in every corner of the picture, " +
          "near and far, tilted every way.",
      ),
      named("Kind", kind),
      h(
        "div",
        { class: "field" },
        h("span", null, "Columns × rows"),
        h("div", { class: "setup-size" }, columns, "×", rows),
      ),
      named("Side of a square, measured on the print", square),
      charuco,
      h("div", { class: "row" }, begin),
      error,
      progress,
    ),
  );

  async function start() {
    const isCharuco = kind.value === "charuco";
    const board = {
      columns: Number(columns.value),
      rows: Number(rows.value),
      square: square.value,
      ...(isCharuco ? { marker: marker.value, dictionary: dictionary.value } : {}),
    };
    stop();
    const mine = (session = Date.now());
    picture.draw("plain");
    if (!(await ask({ do: "start", ...board }))) return stop();
    replace(begin, "Begin again");
    while (mine === session) {
      const isSeen = document.hidden || (await ask({ do: "look" }, mine));
      await new Promise((done) => setTimeout(done, isSeen ? PAUSE_MS : AGAIN_MS));
    }
  }

  function stop() {
    if (session) {
      picture.draw("target");
      picture.mark([]);
    }
    session = 0;
  }

  async function finish() {
    stop();
    take.disabled = true;
    try {
      await setup.show(await api.post("setup/board", { do: "finish" }));
    } catch (wrong) {
      say(wrong.message);
    }
  }

  async function ask(args, mine = session) {
    try {
      const seen = await api.post("setup/board", args);
      if (mine === session) tell(seen);
      return true;
    } catch (wrong) {
      if (mine === session) say(wrong.message);
      return false;
    }
  }

  function tell(seen) {
    say("");
    progress.hidden = false;
    write(words, seen.words);
    words.classList.toggle("is-good", seen.taken);
    share.value = seen.coverage;
    write(
      sum,
      `${seen.views} ${seen.views === 1 ? "view" : "views"}, in ${Math.round(100 * seen.coverage)} % of the picture.`,
    );
    replace(
      missing,
      (seen.missing.length ? seen.missing : ["nothing: it is enough"]).map((each) => h("li", null, each)),
    );
    const hasLens = seen.focal_px !== null;
    write(lens, hasLens ? `Focal length ${seen.focal_px.toFixed(0)} px ± ${seen.focal_sigma_px.toFixed(1)} px.` : "");
    take.disabled = !hasLens;
    picture.mark([
      ...seen.covered_px.map(([x_px, y_px]) => ({ x_px, y_px, kind: "covered" })),
      ...seen.corners_px.map(([x_px, y_px]) => ({ x_px, y_px, kind: "corner" })),
    ]);
  }

  function say(text) {
    error.hidden = !text;
    write(error, text && text[0].toUpperCase() + text.slice(1));
  }

  /** Enter begins here, rather than answering by a distance. */
  function entered(event) {
    if (event.key !== "Enter" || !["INPUT", "SELECT"].includes(event.target.tagName)) return;
    event.preventDefault();
    event.stopPropagation();
    start();
  }
}

const named = (name, field) => h("label", { class: "field" }, h("span", null, name), field);
