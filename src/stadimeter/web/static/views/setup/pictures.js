// The picture files of a camera that shows them: a thumbnail of each, and a distance for those in which it is known.

import { h, replace } from "../../dom.js";
import { choices } from "./question.js";

const WIDTH_PX = 320;

/** A thumbnail of each picture, drawn one after the other. `under(name)` returns what stands below it. */
export function thumbnails(setup, names, { draw = "plain", under = () => null } = {}) {
  const urls = [];
  let isOver = false;
  const views = names.map(() => h("span", { class: "setup-look quiet small" }, "…"));
  setup.onLeave(() => ((isOver = true), urls.forEach((url) => URL.revokeObjectURL(url))));
  (async () => {
    for (const [index, name] of names.entries()) {
      if (isOver || (index && !views[index].isConnected)) return;
      try {
        const { blob, values } = await setup.api.picture(
          `setup/picture.jpg?draw=${draw}&width_px=${WIDTH_PX}&file=${encodeURIComponent(name)}`,
        );
        if (isOver) return;
        urls.push(URL.createObjectURL(blob));
        replace(
          views[index],
          h("img", { src: urls.at(-1), alt: name }),
          draw === "target" &&
            h(
              "span",
              { class: values.found ? "is-found" : "is-wrong" },
              values.found ? `Found, ${Math.round(values.size_px[0])} px across` : values.words,
            ),
        );
      } catch (error) {
        replace(views[index], h("span", { class: "is-wrong" }, error.message));
      }
    }
  })();
  return h(
    "ol",
    { class: "setup-thumbnails" },
    names.map((name, index) =>
      h("li", null, views[index], h("b", { class: "small" }, name.split("/").at(-1)), under(name)),
    ),
  );
}

/** The pictures with a field for the distance in each; the answer has those that are filled in. */
export function distances(step) {
  const { setup, question } = step;
  const names = setup.state.pictures;
  const fields = new Map(
    names.map((name) => [
      name,
      h("input", {
        type: "text",
        autocomplete: "off",
        placeholder: "such as 50 cm",
        "aria-label": `Distance in ${name}`,
        oninput: changed,
      }),
    ]),
  );
  fields.get(names[0]).dataset.first = "";
  const isMine = ({ answer }) => answer.includes("@");
  const ways = question.options.filter((each) => !isMine(each));
  step.onAnswer((answer) => {
    if (![...fields.values()].includes(document.activeElement))
      for (const [name, field] of fields) field.value = distanceIn(answer, name, names);
  });
  return h(
    "div",
    { class: "stack" },
    h(
      "p",
      null,
      "Write how far the middle of the target is from the lens, in each picture in which you know it. " +
        "One is enough; several prove each other.",
    ),
    thumbnails(setup, names, { draw: "target", under: (name) => fields.get(name) }),
    ways.length > 0 &&
      h(
        "details",
        { open: !question.options.some(isMine) },
        h("summary", null, "Without a distance"),
        choices({
          ...step,
          question: { ...question, options: ways },
          set: (answer) => step.set(answer),
          onAnswer: (fn) => step.onAnswer(fn),
        }),
      ),
  );

  function changed() {
    step.set(
      [...fields]
        .filter(([, { value }]) => value.trim())
        .map(([name, { value }]) => quoted(`${name}@${value.trim()}`))
        .join(" "),
    );
  }
}

/** The distance that an answer such as `'a b.jpg@1 m' c.jpg@2m` has for a picture; empty for none. */
function distanceIn(answer, name, names) {
  const plain = ` ${answer.replace(/['"]/g, "")} `;
  const from = plain.indexOf(` ${name}@`);
  if (from < 0) return "";
  const begin = from + name.length + 2;
  const ends = names.map((each) => plain.indexOf(` ${each}@`, begin)).filter((at) => at >= 0);
  return plain.slice(begin, Math.min(plain.length, ...ends)).trim();
}

const quoted = (word) => (/^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\"'\"'")}'`);
