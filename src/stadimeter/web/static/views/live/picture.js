// The camera's picture with what was found in it, both of the same moment. An old picture says that it is old.

import { h, keyed, write } from "../../dom.js";
import * as format from "../../format.js";

const OLD_MS = 800;
const CHECK_MS = 100;
const SERIES = ["#ffe14d", "#5fd3ff", "#ff9bd2", "#9dff8a"]; // on any picture, with a dark rim

export function picture({ live, unit, api, session, say }) {
  const canvas = h("canvas", { role: "img", "aria-label": "The camera's picture" });
  const old = h("p", { class: "old", hidden: true });
  const caption = h("p", { class: "caption", hidden: true });
  const refused = h("ol", { class: "refused small", hidden: true });
  const wanted = h("input", {
    type: "checkbox",
    checked: localStorage.getItem("refused") === "yes",
    onchange: () => {
      localStorage.setItem("refused", wanted.checked ? "yes" : "no");
      draw();
    },
  });
  const record = recordButton({ api, session, say });
  const frame = h("div", { class: "frame" }, canvas, old);
  const element = h("section", { class: "panel picture", "aria-label": "Camera" }, frame, caption);
  const tools = h(
    "section",
    { class: "panel tools", "aria-label": "About the picture" },
    h("div", { class: "row" }, h("label", { class: "row check" }, wanted, "Show what was refused"), record?.element),
    refused,
  );
  let shown = null;

  // The bitmap is good until the next message: what has to be drawn again between two is kept in a canvas of its own.
  const kept = document.createElement("canvas");
  const draw = () => shown && drawAll(canvas, kept, shown, unit, wanted.checked);
  const watch = new ResizeObserver(draw);
  watch.observe(frame);

  const stopMarking = markAge(live, frame, old, () => shown !== null);

  return {
    element,
    tools: { element: tools },
    update(snapshot, bitmap) {
      record?.update(snapshot.recording);
      write(caption, snapshot.narration ? format.words(snapshot.narration, unit) : "");
      caption.hidden = !snapshot.narration;
      if (!snapshot.frame || !bitmap) return;
      kept.width = bitmap.width;
      kept.height = bitmap.height;
      kept.getContext("2d").drawImage(bitmap, 0, 0);
      shown = snapshot;
      frame.style.setProperty("aspect-ratio", `${snapshot.frame.width_px} / ${snapshot.frame.height_px}`);
      draw();
      canvas.dataset.captured = snapshot.frame.captured_unix_s;
      canvas.dataset.drawn = (performance.timeOrigin + performance.now()) / 1000;
      listRefused(refused, snapshot, wanted.checked, unit);
    },
    takeDown() {
      stopMarking();
      watch.disconnect();
    },
  };
}

/** Mark the picture while it is old, or there is none yet. */
function markAge(live, frame, old, hasPicture) {
  const timer = setInterval(() => {
    const age = live.ageMs() ?? 0;
    const isOld = !hasPicture() || age > OLD_MS || live.state.status !== "live";
    if (old.hidden === isOld) old.hidden = !isOld;
    frame.classList.toggle("is-old", isOld);
    if (isOld) write(old, hasPicture() ? `Old picture: ${format.since(age / 1000)}` : "No picture yet");
  }, CHECK_MS);
  return () => clearInterval(timer);
}

function drawAll(canvas, kept, snapshot, unit, withRefused) {
  const sharp = window.devicePixelRatio || 1;
  const width = Math.round(canvas.clientWidth * sharp);
  if (!width) return;
  const scale = width / snapshot.frame.width_px;
  canvas.width = width;
  canvas.height = Math.round(snapshot.frame.height_px * scale);
  const ink = canvas.getContext("2d");
  ink.drawImage(kept, 0, 0, canvas.width, canvas.height);
  ink.font = `600 ${15 * sharp}px system-ui, sans-serif`;
  ink.lineJoin = "round";
  if (withRefused) numbered(snapshot).forEach((each, index) => drawRefused(ink, each, index + 1, scale, sharp));
  snapshot.targets.forEach(
    (target, index) =>
      target.detection &&
      target.detection.status !== "not_found" &&
      drawTarget(ink, target, SERIES[index % SERIES.length], { scale, sharp, unit }),
  );
}

function drawTarget(ink, { name, detection, distance_m, sigma_m, is_valid }, colour, { scale, sharp, unit }) {
  const outline = detection.outline_px.map(([x, y]) => [(x + 0.5) * scale, (y + 0.5) * scale]);
  const [x, y] = detection.centre_px.map((each) => (each + 0.5) * scale);
  const path = new Path2D();
  outline.forEach(([px, py], index) => (index ? path.lineTo(px, py) : path.moveTo(px, py)));
  if (outline.length) path.closePath();
  for (const [dx, dy] of [
    [7, 0],
    [0, 7],
  ]) {
    path.moveTo(x - dx * sharp, y - dy * sharp);
    path.lineTo(x + dx * sharp, y + dy * sharp);
  }
  rimmed(ink, path, colour, sharp, detection.status === "truncated");
  const right = Math.max(x, ...outline.map(([px]) => px)) + 10 * sharp;
  const words = `${name} ${is_valid ? format.distance(distance_m, sigma_m, unit).text : "not sure"}`;
  label(ink, words, right, y, colour, sharp);
}

function drawRefused(ink, { centre_px, corners_px, size_px }, number, scale, sharp) {
  const [x, y] = centre_px.map((each) => (each + 0.5) * scale);
  const path = new Path2D();
  if (corners_px?.length) {
    corners_px.forEach(([px, py], index) =>
      index ? path.lineTo(px * scale, py * scale) : path.moveTo(px * scale, py * scale),
    );
    path.closePath();
  } else path.arc(x, y, Math.max(6 * sharp, (size_px / 2) * scale), 0, 2 * Math.PI);
  rimmed(ink, path, "#fff", sharp, true);
  label(ink, String(number), x + Math.max(8 * sharp, (size_px / 2) * scale + 4 * sharp), y, "#fff", sharp);
}

function rimmed(ink, path, colour, sharp, isDashed) {
  ink.setLineDash([]);
  ink.strokeStyle = "rgb(0 0 0 / 0.75)";
  ink.lineWidth = 5 * sharp;
  ink.stroke(path);
  ink.setLineDash(isDashed ? [7 * sharp, 5 * sharp] : []);
  ink.strokeStyle = colour;
  ink.lineWidth = 2.5 * sharp;
  ink.stroke(path);
  ink.setLineDash([]);
}

/** Words to the right of a place, kept within the picture. */
function label(ink, words, x, y, colour, sharp) {
  const width = ink.measureText(words).width + 12 * sharp;
  const height = 24 * sharp;
  const left = Math.max(2, Math.min(x, ink.canvas.width - width - 2));
  const top = Math.max(2, Math.min(y - height / 2, ink.canvas.height - height - 2));
  ink.fillStyle = "rgb(0 0 0 / 0.72)";
  ink.beginPath();
  ink.roundRect(left, top, width, height, 5 * sharp);
  ink.fill();
  ink.fillStyle = colour;
  ink.textBaseline = "middle";
  ink.fillText(words, left + 6 * sharp, top + height / 2 + sharp);
}

const numbered = (snapshot) =>
  snapshot.targets.flatMap((target) => target.rejected.map((each) => ({ ...each, target: target.name }))).slice(0, 9);

function listRefused(list, snapshot, isWanted, unit) {
  const refused = isWanted ? numbered(snapshot) : [];
  list.hidden = !isWanted;
  if (isWanted && !refused.length) refused.push({ reason: "" });
  keyed(
    list,
    refused.map((each, index) => ({ ...each, index })),
    (each) => each.index,
    () => {
      const item = h("li");
      item.update = ({ index, target, size_px, reason }) =>
        write(
          item,
          !target
            ? "Nothing was refused in this picture."
            : `${index + 1}  no ${target} (${Math.round(size_px)} px): ${format.words(reason, unit)}`,
        );
      return item;
    },
  );
}

function recordButton({ api, session, say }) {
  if (session.right !== "operate") return null;
  let isRecording = false;
  const element = h(
    "button",
    {
      type: "button",
      class: "button record",
      onclick: async () => {
        const wish = isRecording ? "stop" : "start"; // the run may say that it has stopped before it answers
        try {
          const answer = await api.post("recordings", { do: wish });
          if (wish === "stop") say(`Recorded: ${answer?.file ?? ""}`);
        } catch (error) {
          say(error.message, "error");
        }
      },
    },
    "Record",
  );
  return {
    element,
    update(recording) {
      isRecording = Boolean(recording);
      element.classList.toggle("is-on", isRecording);
      write(
        element,
        recording ? `Stop recording, ${format.span(recording.seconds)}, ${format.size(recording.bytes)}` : "Record",
      );
    },
  };
}
