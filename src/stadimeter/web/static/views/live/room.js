// The simulated room from above: its ball can be put anywhere, and things can be made to go wrong.

import * as format from "../../format.js";
import { latest } from "../../latest.js";
import { Button, html, useRef, useState } from "../../ui.js";

const REACH_M = [3, 5, 8, 12, 20, 100]; // the drawing has room for this much, and grows
const STEP_M = 0.1;
const SEND_MS = 100; // a ball that is dragged asks far more often
const HELD_MS = 500; // so long the hand counts for more than what the run says
const WAY = "Drag the ball, or move it with the arrow keys. The rings are 1 m apart.";
const KEYS = { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1] };
const RINGS = Array.from({ length: 20 }, (_, at) => at + 1);

/** x is up in the drawing, y to the left: as the robot sees the room at first. */
const place = ({ x_m, y_m }) => [-y_m, -x_m];

/** `send({target, x_m, y_m})`, `send({fault})` and `send({release})` change what `world` tells. */
export function Room({ world, send, session, unit, say }) {
  const isAlive = Object.keys(world.faults).length > 0;
  const isOurs = session.right === "operate";
  const [held, hold] = useState({ until_ms: 0 });
  const reach_m = useRef(0);
  const wishes = useRef(null);
  wishes.current ??= latest(async (_, body) => {
    await send(body).catch((error) => say(error.message, "error"));
    await new Promise((done) => setTimeout(done, SEND_MS));
  });
  const { camera = { x_m: 0, y_m: 0, heading_rad: 0 } } = world;
  const isHeld = (name) => held.name === name && performance.now() < held.until_ms;
  const wish = (body, shown) => {
    hold({ ...shown, until_ms: performance.now() + HELD_MS });
    wishes.current(body);
  };
  const targets = world.targets.map((target) => (isHeld(target.name) ? { ...target, ...held } : target));
  reach_m.current = reachOf([...targets, camera], reach_m.current);
  const move = ({ name }, x_m, y_m) => {
    const [x, y] = [x_m, y_m].map((each) => Math.max(-reach_m.current, Math.min(reach_m.current, each)));
    wish({ target: name, x_m: x, y_m: y }, { name, x_m: x, y_m: y });
  };
  const box = ([fault, isOn]) => html`<label key=${fault} class="row check">
    <input type="checkbox" disabled=${!isOurs} checked=${isHeld(fault) ? held.isOn : isOn}
      onchange=${(event) => wish({ fault }, { name: fault, isOn: event.target.checked })} />${fault.replaceAll("-", " ")}
  </label>`;
  return html`
    <${Plan} reach_m=${reach_m.current} camera=${camera} targets=${targets} move=${isOurs && move} />
    ${targets.map((target) => html`<p class="small number">${target.name}: ${seenFrom(camera, target, unit)}</p>`)}
    ${isOurs && html`<p class="small quiet">${WAY}</p>`}
    ${isOurs && isAlive && html`<${Button} onclick=${() => wishes.current({ release: true })}>Let it go on by itself<//>`}
    <div class="faults">${Object.entries(world.faults).map(box)}</div>`;
}

function reachOf(places, now_m) {
  const wanted = Math.max(...places.flatMap(({ x_m, y_m }) => [Math.abs(x_m), Math.abs(y_m)])) + 0.4;
  return wanted <= now_m ? now_m : (REACH_M.find((each) => each >= wanted) ?? wanted);
}

/** The drawing: the camera where it is, and each target, which follows the hand at once. */
function Plan({ reach_m, camera, targets, move }) {
  const [x, y] = place(camera);
  const turned = `translate(${x} ${y}) rotate(${(-camera.heading_rad * 180) / Math.PI})`;
  return html`<svg class="plan" role="group" aria-label="The room from above"
    viewBox=${`${-reach_m} ${-reach_m} ${2 * reach_m} ${2 * reach_m}`}>
    ${RINGS.map((r) => html`<circle r=${r} class="ring" />`)}
    <g transform=${turned}><path d="M0 0L-1.6-3H1.6Z" class="sight" /><path d="M0-.3L.22.25H-.22Z" class="robot" /></g>
    ${targets.map((target) => html`<${Ball} key=${target.name} target=${target} move=${move} />`)}
  </svg>`;
}

function Ball({ target, move }) {
  const [cx, cy] = place(target);
  const name = `${target.name} in the room`;
  if (!move) return html`<circle r="0.28" class="ball" role="img" aria-label=${name} cx=${cx} cy=${cy} />`;
  const drag = ({ currentTarget: mark, pointerId, clientX, clientY }) => {
    if (!mark.hasPointerCapture(pointerId)) return;
    const to = new DOMPoint(clientX, clientY).matrixTransform(mark.ownerSVGElement.getScreenCTM().inverse());
    move(target, -to.y, -to.x);
  };
  const step = (event) => {
    const by = KEYS[event.key];
    if (!by) return;
    event.preventDefault();
    move(target, target.x_m + by[0] * STEP_M, target.y_m + by[1] * STEP_M);
  };
  return html`<circle r="0.28" class="ball" tabindex="0" role="button" aria-label=${name} cx=${cx} cy=${cy}
    onpointerdown=${(event) => event.currentTarget.setPointerCapture(event.pointerId)} onpointermove=${drag}
    onkeydown=${step} />`;
}

/** How far a target is from the camera, and where it has to look. */
function seenFrom(camera, { x_m, y_m }, unit) {
  const [dx, dy] = [x_m - camera.x_m, y_m - camera.y_m];
  const left_rad = Math.atan2(dy, dx) - camera.heading_rad;
  const away = `${format.distance(Math.hypot(dx, dy), 0.01, unit).value} ${unit.symbol} from the camera`;
  return `${away}, ${format.bearing(-Math.atan2(Math.sin(left_rad), Math.cos(left_rad)))}`;
}
