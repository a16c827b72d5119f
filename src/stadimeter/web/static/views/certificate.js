// The certificate of the site: the target at taped distances, one after the other, and what came of it.

import { button, h, replace } from "../dom.js";

const HOW = "Put the target at a distance, measured with a tape from the lens to its nearest point. Keep all still.";
const WATCHING = "Watching for some seconds: keep all still …";

export function mount(root, { api, say }) {
  const form = h("div", { class: "stack" });
  const found = h("div", { class: "stack" });
  const asked = h("section", { class: "panel stack" }, h("h1", null, "Certificate of the site"), form);
  replace(root, h("div", { class: "stack" }, asked, found));
  ask("Reading the configuration …", () => api.get("certificate"));

  /** Ask something that answers with the state, and show that; after an error, the state as it is. */
  async function ask(words, question) {
    replace(form, h("p", { role: "status" }, words));
    try {
      draw(await question());
    } catch (error) {
      say(error.message, "error");
      const failed = (other) => replace(form, h("p", { class: "banner is-error" }, other.message));
      await api.get("certificate").then(draw, failed);
    }
  }

  function draw({ left_m, remark, placements, certificate }) {
    const distance = h("input", { value: left_m.length ? `${left_m[0]} m` : "" });
    const sigma = h("input", { value: "2 mm" });
    const field = (words, input) => h("label", { class: "field" }, h("span", null, words), input);
    const take = () => api.post("certificate/take", { distance: distance.value, sigma: sigma.value });
    const finish = () => ask("Writing …", () => api.post("certificate/finish"));
    replace(
      form,
      h("p", null, HOW),
      remark && h("p", null, remark),
      row(field("Distance", distance), field("Known to ±", sigma)),
      row(button("Measure", () => ask(WATCHING, take))),
      list(placements.map(({ words }) => words)),
      placements.filter((each) => each.is_read).length > 2 && button("Write the certificate", finish),
    );
    replace(found, certificate && drawCertificate(certificate));
  }
}

const row = (...children) => h("div", { class: "row" }, children);
const list = (sentences) => h("ul", { class: "list" }, ...sentences.map((words) => h("li", null, words)));

const drawCertificate = ({ date, outdated, words, rules }) =>
  h(
    "section",
    { class: "panel stack", "aria-label": "Certificate" },
    h("h2", null, `Measured ${date}`),
    outdated && h("p", { class: "banner is-warning" }, `Out of date: ${outdated}.`),
    words.map((each) => h("p", null, each)),
    list(rules),
    row(h("a", { href: "/api/v1/certificate.html", target: "_blank", class: "button" }, "To print")),
  );
