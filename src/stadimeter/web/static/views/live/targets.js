// Each target's distance as a large number, with its ±, and how it moves.

import { button, h, keyed, write } from "../../dom.js";
import * as format from "../../format.js";

const KINDS = { tracking: "good", coasting: "warning", searching: "unknown", lost: "warning" };
const WORDS = { tracking: "tracking", coasting: "coasting: not seen just now", searching: "searching", lost: "lost" };

export function targets(context) {
  const element = h("div", { class: "figures" });
  return {
    element,
    update: (snapshot) =>
      keyed(
        element,
        snapshot.targets.map((target) => ({ ...target, colour: snapshot.run?.colours?.[target.name] })),
        (target) => target.name,
        () => card(context),
      ),
  };
}

/** What is remembered over a window of time, each figure with its value now. */
export function remembered({ unit }) {
  const list = h("ul", { class: "list small" });
  const element = h("section", { class: "panel remembered" }, h("h2", null, "Remembered"), list);
  return {
    element,
    update({ figures = [] }) {
      element.hidden = !figures.length;
      keyed(
        list,
        figures,
        (figure) => figure.name,
        () => line(unit),
      );
    },
  };
}

const inUnit = ({ value, unit: si }, unit) =>
  value === null
    ? "not known"
    : si === "rad"
      ? format.bearing(value)
      : si === "m/s"
        ? format.speed(value, unit)
        : format.distance(value, null, unit).text;

function line(unit) {
  const [name, value, words] = [h("strong"), h("span", { class: "number" }), h("span", { class: "quiet" })];
  const element = h("li", null, name, " ", value, " ", words);
  element.update = (figure) => {
    write(name, figure.name);
    write(value, inUnit(figure, unit));
    write(words, figure.words);
  };
  return element;
}

function card(context) {
  const { unit } = context;
  const name = h("h2");
  const status = h("span");
  const value = h("span", { class: "value" });
  const about = h("span", { class: "about" });
  const moves = h("p", { class: "moves" });
  const reason = h("p", { class: "quiet small" });
  let table = "";
  const colour = button("Colour …", async () => (await import("./colour.js")).openColour(table, context), "small");
  const element = h(
    "section",
    { class: "panel target" },
    h("div", { class: "row head" }, name, status),
    h("p", { class: "figure number" }, value, h("span", { class: "unit" }, unit.symbol), about),
    moves,
    reason,
    colour,
  );
  element.update = (target) => {
    const figure = target.is_valid ? format.distance(target.distance_m, target.sigma_m, unit) : format.distance(null);
    write(name, target.name);
    table = target.colour;
    colour.hidden = !table || context.session.right !== "operate";
    status.className = `badge is-${KINDS[target.status] ?? "quiet"}`;
    write(status, WORDS[target.status] ?? target.status);
    write(value, figure.value);
    write(about, figure.sigma ? `± ${figure.sigma}` : "");
    element.classList.toggle("is-unknown", !target.is_valid);
    const parts = [
      format.bearing(target.bearing_rad),
      format.closing(target.closing_mps, target.closing_sigma_mps, unit),
      format.tilt(target.tilt_rad),
    ];
    write(moves, target.is_valid ? parts.filter(Boolean).join(" · ") : "no distance that may be acted on");
    write(reason, format.words(target.reason || target.detection?.reason || "", unit));
  };
  return element;
}
