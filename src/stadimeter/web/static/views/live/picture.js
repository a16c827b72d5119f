// The camera's picture with what was found in it and its distance, all of the same moment. An old one says that it is.

import { api } from "../../api.js";
import * as format from "../../format.js";
import { Badge, Button, html, useKept, useLayoutEffect, useRef, useSnapshot, useState } from "../../ui.js";

const OLD_MS = 800;
const CHECK_MS = 100;
const REFUSED_MAX = 9;
const SERIES = ["#ffe14d", "#5fd3ff", "#ff9bd2", "#9dff8a"]; // on any picture, with a dark rim
const KINDS = { coasting: "warning", searching: "unknown", lost: "warning" };
const WORDS = { coasting: "coasting: not seen just now" };

export function Picture(context) {
  const { live, unit } = context;
  const [refused] = useKept("refused", "no");
  const snapshot = useSnapshot(live);
  return html`<section class="panel picture" aria-label="Camera">
    <${Frame} live=${live} unit=${unit} withRefused=${refused === "yes"} />
    ${snapshot?.narration && html`<p class="caption">${format.words(snapshot.narration, unit)}</p>`}
  </section>`;
}

/** What there is to do about the picture: record it, choose the colour of a ball, and see what was refused. */
export function Tools({ snapshot, ...context }) {
  const { unit, session } = context;
  const [refused, keep] = useKept("refused", "no");
  const isWanted = refused === "yes";
  const canOperate = session.right === "operate";
  const colours = Object.entries((canOperate && snapshot.run?.colours) || {});
  const open = async (table) => (await import("./colour.js")).openColour(table, context);
  const colour = ([name, table]) => {
    const words = colours.length > 1 ? `Colour of ${name} …` : "Colour …";
    return html`<${Button} key=${name} onclick=${() => open(table)}>${words}<//>`;
  };
  return html`<div class="row">
      ${canOperate && html`<${Record} recording=${snapshot.recording} say=${context.say} />`}
      ${colours.map(colour)}
      <label class="row check"><input type="checkbox" checked=${isWanted}
        onchange=${(event) => keep(event.target.checked ? "yes" : "no")} />Show what was refused</label>
    </div>
    ${isWanted && html`<${Refused} found=${numbered(snapshot)} unit=${unit} />`}`;
}

export function Frame({ live, unit, withRefused }) {
  const [frame, canvas] = [useRef(), useRef()];
  const shown = useRef({ snapshot: null, bitmap: null });
  const [age, setAge] = useState("No picture yet");
  shown.current.withRefused = withRefused;
  useLayoutEffect(() => {
    const draw = () => drawAll(canvas.current, shown.current);
    const leave = live.subscribe((snapshot, bitmap) => {
      if (!snapshot.frame || !bitmap) return;
      const { width_px, height_px, captured_unix_s } = snapshot.frame;
      Object.assign(shown.current, { snapshot, bitmap }); // the bitmap is good until the next one
      frame.current.style.setProperty("--shape", `${width_px} / ${height_px}`);
      draw();
      canvas.current.dataset.captured = captured_unix_s;
      canvas.current.dataset.drawn = (performance.timeOrigin + performance.now()) / 1000;
    });
    const check = () => {
      const age_ms = live.ageMs() ?? 0;
      const isOld = age_ms > OLD_MS || live.state.status !== "live";
      setAge(!shown.current.snapshot ? "No picture yet" : isOld ? `Old picture: ${format.since(age_ms / 1000)}` : "");
    };
    const timer = setInterval(check, CHECK_MS);
    const watch = new ResizeObserver(draw);
    watch.observe(frame.current);
    return () => (leave(), clearInterval(timer), watch.disconnect());
  }, [live]);
  return html`<div class=${`frame ${age && "is-old"}`} ref=${frame}>
    <canvas role="img" aria-label="The camera's picture" ref=${canvas} />
    <p class="old" hidden=${!age}>${age}</p>
    <${Figures} live=${live} unit=${unit} />
  </div>`;
}

/** Each target's distance as a large number on the picture, with its ±, and how it moves. */
function Figures({ live, unit }) {
  const snapshot = useSnapshot(live, 100);
  const steady = useRef(null);
  steady.current ??= format.steadyDistances();
  const targets = snapshot?.targets ?? [];
  return html`<div class=${`figures ${targets.length > 2 ? "many" : ""}`}>
    ${targets.map((target) => html`<${Figure} key=${target.name} ...${target} unit=${unit} steady=${steady.current} />`)}
  </div>`;
}

function Figure({ unit, steady, ...target }) {
  const { name, status, is_valid, distance_m, sigma_m, reason, detection } = target;
  const { value, sigma } = is_valid ? steady(name, distance_m, sigma_m, unit) : format.distance(null);
  const moves = [
    format.bearing(target.bearing_rad),
    format.closing(target.closing_mps, target.closing_sigma_mps, unit),
    format.tilt(target.tilt_rad),
  ];
  return html`<div class=${`target ${is_valid ? "" : "is-unknown"}`}>
    <div class="row"><h2>${name}</h2>
      ${status !== "tracking" && html`<${Badge} kind=${KINDS[status] ?? "quiet"}>${WORDS[status] ?? status}<//>`}</div>
    <p class="figure number"><span class="value">${value}</span>${" "}<span class="unit">${is_valid && unit.symbol}</span>${" "}<span class="about">${sigma && `± ${sigma}`}</span></p>
    <p class="moves small">${is_valid ? moves.filter(Boolean).join(" · ") : "no distance that may be acted on"}</p>
    ${(reason || detection?.reason) && html`<p class="small">${format.words(reason || detection.reason, unit)}</p>`}
  </div>`;
}

function Refused({ found, unit }) {
  const words = ({ target, size_px, reason }) =>
    `no ${target} (${Math.round(size_px)} px): ${format.words(reason, unit)}`;
  return html`<ol class="refused small">
    ${found.map((each, at) => html`<li>${at + 1}  ${words(each)}</li>`)}
    ${!found.length && html`<li>Nothing was refused in this picture.</li>`}
  </ol>`;
}

/** Begins a recording, or ends the one that goes on. */
export function Record({ recording, say, done = () => {}, ...rest }) {
  const press = async () => {
    const wish = recording ? "stop" : "start"; // the run may say that it has stopped before it answers
    try {
      const answer = await api.post("recordings", { do: wish });
      if (wish === "stop") say(`Recorded: ${answer?.file ?? ""}`);
    } catch (error) {
      say(error.message, "error");
    }
    done();
  };
  const words = recording && `Stop recording, ${format.span(recording.seconds)}, ${format.size(recording.bytes)}`;
  return html`<${Button} kind=${`record ${recording ? "is-on" : ""}`} onclick=${press} ...${rest}>
    ${words || "Record"}<//>`;
}

const numbered = ({ targets }) =>
  targets.flatMap(({ name, rejected }) => rejected.map((each) => ({ ...each, target: name }))).slice(0, REFUSED_MAX);

/** All is drawn in the pixels of the page: the canvas may have more. */
function drawAll(canvas, { snapshot, bitmap, withRefused }) {
  const sharp = window.devicePixelRatio || 1;
  const { clientWidth } = canvas;
  if (!clientWidth || !bitmap?.width) return;
  const scale = clientWidth / snapshot.frame.width_px;
  const [width, height] = [clientWidth, snapshot.frame.height_px * scale].map((each) => Math.round(each * sharp));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const ink = canvas.getContext("2d");
  ink.setTransform(1, 0, 0, 1, 0, 0);
  ink.drawImage(bitmap, 0, 0, width, height);
  ink.scale(sharp, sharp);
  ink.font = "600 15px system-ui, sans-serif";
  ink.lineJoin = "round";
  if (withRefused) numbered(snapshot).forEach((each, at) => drawRefused(ink, each, at + 1, scale));
  const seen = ({ detection }) => detection && detection.status !== "not_found";
  snapshot.targets.forEach((each, at) => seen(each) && drawTarget(ink, each, SERIES[at % SERIES.length], scale));
}

/** Its outline and its centre, and its name: its distance stands in the corner. */
function drawTarget(ink, { name, detection, is_valid }, colour, scale) {
  const outline = detection.outline_px.map((point) => point.map((each) => (each + 0.5) * scale));
  const [x, y] = detection.centre_px.map((each) => (each + 0.5) * scale);
  const path = through(outline);
  path.addPath(new Path2D(`M${x - 7} ${y}H${x + 7}M${x} ${y - 7}V${y + 7}`));
  rimmed(ink, path, colour, detection.status === "truncated");
  const right = Math.max(x, ...outline.map(([px]) => px)) + 10;
  label(ink, is_valid ? name : `${name} not sure`, right, y, colour);
}

function drawRefused(ink, { centre_px, corners_px, size_px }, number, scale) {
  const [x, y] = centre_px.map((each) => (each + 0.5) * scale);
  const path = through((corners_px ?? []).map((point) => point.map((each) => each * scale)));
  if (!corners_px?.length) path.arc(x, y, Math.max(6, (size_px / 2) * scale), 0, 2 * Math.PI);
  rimmed(ink, path, "#fff", true);
  label(ink, String(number), x + Math.max(8, (size_px / 2) * scale + 4), y, "#fff");
}

const through = (points) => new Path2D(points.length ? `M${points.join("L")}Z` : "");

function rimmed(ink, path, colour, isDashed) {
  ink.setLineDash([]);
  ink.strokeStyle = "rgb(0 0 0 / 0.75)";
  ink.lineWidth = 5;
  ink.stroke(path);
  ink.setLineDash(isDashed ? [7, 5] : []);
  ink.strokeStyle = colour;
  ink.lineWidth = 2.5;
  ink.stroke(path);
}

/** Words to the right of a place, kept within the picture. */
function label(ink, words, x, y, colour) {
  const [width, height] = [ink.measureText(words).width + 12, 24];
  const { clientWidth, clientHeight } = ink.canvas;
  const left = Math.max(2, Math.min(x, clientWidth - width - 2));
  const top = Math.max(2, Math.min(y - height / 2, clientHeight - height - 2));
  ink.fillStyle = "rgb(0 0 0 / 0.72)";
  ink.beginPath();
  ink.roundRect(left, top, width, height, 5);
  ink.fill();
  ink.fillStyle = colour;
  ink.textBaseline = "middle";
  ink.fillText(words, left + 6, top + height / 2 + 1);
}
