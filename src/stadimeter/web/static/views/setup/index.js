import { h, replace } from "../../dom.js";

export function mount(root) {
  replace(root, h("section", { class: "panel" }, h("h1", null, "Set-up")));
  return () => {};
}
