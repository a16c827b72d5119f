import { h, replace } from "../../dom.js";

export function mount(root, { live }) {
  const canvas = h("canvas", { width: 640, height: 480 });
  replace(root, h("section", { class: "panel" }, h("h1", null, "Live"), canvas));
  return live.subscribe((snapshot, bitmap) => {
    if (bitmap) canvas.getContext("2d").drawImage(bitmap, 0, 0, canvas.width, canvas.height);
  });
}
