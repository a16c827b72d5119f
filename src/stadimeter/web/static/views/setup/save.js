// Save: what would be written and what changes, what `check` and the tests say; then save it, and run it.

import { differenceView } from "../../difference.js";
import { h, inCode, replace } from "../../dom.js";

export function widget(setup) {
  const root = h("div", { class: "panel stack" }, h("p", { class: "quiet" }, "Writing it, and trying its tests …"));
  load(setup, root);
  return root;
}

async function load(setup, root, words = "") {
  const { api } = setup;
  try {
    const made = await api.post("setup/files");
    draw(setup, root, made, await api.get("configuration"), words);
  } catch (error) {
    replace(
      root,
      h("p", { class: "setup-error", role: "alert" }, error.message),
      h(
        "div",
        { class: "row" },
        back(setup),
        h("button", { type: "button", class: "button", onclick: () => load(setup, root) }, "Try again"),
      ),
    );
  }
}

function draw(setup, root, made, there, words) {
  const [configuration, ...others] = made.files;
  const said = h("div", { class: "setup-error", role: "alert", hidden: !words }, words);
  const errors = made.findings.filter(({ severity }) => severity === "error");
  const save = (runs) => async (event) => {
    const buttons = root.querySelectorAll("button");
    buttons.forEach((each) => (each.disabled = true));
    try {
      await saved(setup, made, there.version, runs);
    } catch (error) {
      if (error.code === "conflict")
        return void load(
          setup,
          root,
          `${error.message}. Below is what yours changes in theirs; save again to go on with yours. ` +
            "Theirs is kept as a former version.",
        );
      said.hidden = false;
      replace(said, error.message);
    }
    buttons.forEach((each) => (each.disabled = false));
    event.target.focus();
  };
  const isSame = there.exists && there.text === configuration.text;
  replace(
    root,
    made.words.length > 0 &&
      h(
        "section",
        null,
        h("h2", null, "What it does"),
        h(
          "ul",
          { class: "setup-words" },
          made.words.map((each) => h("li", null, inCode(each))),
        ),
      ),
    made.findings.length > 0 &&
      h(
        "section",
        null,
        h("h2", null, "What was found in it"),
        h("ul", { class: "setup-findings" }, made.findings.map(finding)),
      ),
    tests(made.tests),
    said,
    h(
      "div",
      { class: "row setup-way" },
      back(setup),
      h("button", { type: "button", class: "button", disabled: errors.length > 0, onclick: save(false) }, "Save only"),
      h(
        "button",
        { type: "button", class: "button primary", "data-first": "", disabled: errors.length > 0, onclick: save(true) },
        "Save, and run it",
      ),
    ),
    h(
      "details",
      { open: there.exists && !isSame },
      h(
        "summary",
        null,
        !there.exists
          ? `The configuration: ${configuration.name}`
          : isSame
            ? "The configuration is as it was"
            : "What changes in the configuration",
      ),
      (there.exists && differenceView(there.text, configuration.text, "What changes in the configuration")) ||
        text(configuration),
    ),
    others.map((each) => h("details", null, h("summary", null, each.name), text(each))),
  );
  root.querySelector("[data-first]")?.focus({ preventScroll: true });
}

/** Save, let go of the camera, and have the run go by it: started, reloaded or restarted, as the answer says. */
async function saved(setup, made, version, runs) {
  const { api, context } = setup;
  const [configuration, ...others] = made.files;
  const { needs } = await api.put("configuration", {
    text: configuration.text,
    base_version: version,
    files: Object.fromEntries(others.map(({ name, text }) => [name, text])),
  });
  if (!runs) return void context.say("It is saved. The run goes by it when it is started, or reloaded.");
  setup.picture.stop(); // it would take the camera again
  await api.post("setup/leave", { camera_only: true });
  try {
    if (needs !== "nothing") await api.post(`run/${needs}`);
    await api.post("setup/leave");
  } catch (error) {
    setup.picture.start();
    throw Object.assign(error, { message: `It is saved, but it does not run: ${error.message}` });
  }
  context.say("It is saved, and runs.");
  context.live.retry();
  location.hash = "live";
}

const text = (file) => h("pre", { class: "setup-file", tabindex: 0, "aria-label": file.name }, file.text);

const back = (setup) => h("button", { type: "button", class: "button", onclick: () => setup.back() }, "Back");

const finding = ({ severity, message, line, hint }) =>
  h(
    "li",
    { class: severity === "error" ? "is-wrong" : "" },
    h("b", null, severity === "error" ? "Error" : "Warning", line ? `, line ${line}: ` : ": "),
    inCode(message),
    hint && h("span", { class: "quiet" }, " (", inCode(hint), ")"),
  );

function tests(all) {
  const failed = all.filter(({ ok }) => !ok);
  if (!all.length) return null;
  return h(
    "section",
    null,
    h("h2", null, failed.length ? `${failed.length} of ${all.length} tests fail` : `All ${all.length} tests pass`),
    h(
      "ul",
      { class: "setup-tests" },
      all.map(({ name, ok, words }) =>
        h(
          "li",
          { class: ok ? "is-good" : "is-wrong" },
          h("span", { "aria-hidden": "true" }, ok ? "✓ " : "✗ "),
          name,
          h("span", { class: "sr" }, ok ? ": passes" : ": fails"),
          !ok && h("span", null, `: ${words}`),
        ),
      ),
    ),
  );
}
