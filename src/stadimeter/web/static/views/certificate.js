// The certificate of the site: the target at taped distances, one after the other, and what came of it.

import { h, replace } from "../dom.js";

export function mount(root, context) {
  const { api, say } = context;
  const form = h("div", { class: "stack" });
  const found = h("div", { class: "stack" });
  replace(root, h("section", { class: "panel stack" }, h("h1", null, "Certificate of the site"), form), found);
  const ask = async (words, question) => {
    replace(form, h("p", { role: "status" }, words));
    try {
      draw(await question());
    } catch (error) {
      say(error.message, "error");
      await api.get("certificate").then(draw, (other) => replace(form, h("p", { class: "banner is-error" }, other.message)));
    }
  };
  ask("Reading the configuration …", () => api.get("certificate"));

  function draw({ left_m, placements, certificate }) {
    const value = (name) => form.querySelector(`[name=${name}]`).value;
    const field = (name, words, text) => h("label", { class: "field" }, h("span", null, words), h("input", { name, value: text }));
    const take = () => {
      const body = { distance: value("distance"), sigma: value("sigma") };
      ask("Watching for some seconds: keep everything still …", () => api.post("certificate/take", body));
    };
    const finish = (correct) => ask("Writing the certificate …", () => api.post("certificate/finish", { correct }));
    const button = (words, onclick, kind = "") => h("button", { type: "button", class: `button ${kind}`, onclick }, words);
    replace(form,
      h("p", null, "Put the target at a distance, measured with a tape from the lens to its nearest point. Keep it and the camera still."),
      h("div", { class: "row" }, field("distance", "Distance", left_m.length ? `${left_m[0]} m` : ""), field("sigma", "Known to ±", "2 mm"), button("Measure", take, "primary")),
      placements.length > 0 && h("ul", { class: "list" }, placements.map(({ words }) => h("li", null, words))),
      placements.filter((each) => each.is_read).length > 2 && h("div", { class: "row" }, button("Write the certificate", () => finish(false)), button("Write it and correct the focal length", () => finish(true))));
    replace(found, certificate && h("section", { class: "panel stack", "aria-label": "Certificate" },
      h("h2", null, `Measured ${certificate.date}`),
      certificate.outdated && h("p", { class: "banner is-warning" }, `Out of date: ${certificate.outdated}.`),
      certificate.words.map((words) => h("p", null, words)),
      h("ul", { class: "list" }, certificate.rules.map(({ words, trouble }) => h("li", null, trouble ? `${words}: not carried, ${trouble}` : `${words}: carried`))),
      h("p", null, h("a", { href: "/api/v1/certificate.pdf", target: "_blank" }, "The certificate as a PDF"))));
  }
}
