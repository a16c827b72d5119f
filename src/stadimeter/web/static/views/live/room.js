// The simulated room from above: its ball can be put anywhere, and things can be made to go wrong.

import { h, keyed, svg, write } from "../../dom.js";
import * as format from "../../format.js";

const REACH_M = [3, 5, 8, 12, 20, 100]; // the drawing has room for this much, and grows
const STEP_M = 0.1;
const SEND_MS = 100;
const HELD_MS = 500; // so long the hand counts for more than what the run says
const KEYS = { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1] };

/** x is up in the drawing, y to the left: as the robot sees the room at first. */
const place = ({ x_m, y_m }) => [-y_m, -x_m];

export function room({ api, session, unit, say }) {
  const isOurs = session.right === "operate";
  const send = sender(api, say);
  const where = h("p", { class: "small number", role: "status" });
  const plan = planOf(isOurs, send, (target, camera) =>
    write(where, `${target.name}: ${seenFrom(camera, target, unit)}`),
  );
  const faults = h("div", { class: "faults" });
  const ways = isOurs && [
    h("p", { class: "small quiet" }, "Drag the ball, or move it with the arrow keys. The rings are 1 m apart."),
    h("button", { type: "button", class: "button", onclick: () => send({ release: true }) }, "Let it go on by itself"),
  ];
  const element = h(
    "section",
    { class: "panel room", hidden: true },
    h("h2", null, "Simulated room"),
    plan.element,
    where,
    ways,
    faults,
  );
  const toggle = ({ name }) => {
    let until = 0; // what was just wished counts for more than what the run says
    const wish = () => ((until = performance.now() + HELD_MS), send({ fault: name }));
    const box = h("input", { type: "checkbox", disabled: !isOurs, onchange: wish });
    const update = ({ isOn }) => performance.now() > until && (box.checked = isOn);
    return Object.assign(h("label", { class: "row check" }, box, name.replaceAll("-", " ")), { update });
  };
  return {
    element,
    update({ run }) {
      element.hidden = !run?.world;
      if (!run?.world) return;
      plan.update(run.world);
      keyed(
        faults,
        Object.entries(run.world.faults).map(([name, isOn]) => ({ name, isOn })),
        (fault) => fault.name,
        toggle,
      );
    },
  };
}

/** The drawing: the camera where it is, and each target, which follows the hand at once. */
function planOf(isOurs, send, tell) {
  const robot = svg(
    "g",
    null,
    svg("path", { d: "M0 0L-1.6-3H1.6Z", class: "sight" }),
    svg("path", { d: "M0-.3L.22.25H-.22Z", class: "robot" }),
  );
  const balls = svg("g");
  const rings = Array.from({ length: 20 }, (_, index) => svg("circle", { r: index + 1, class: "ring" }));
  const element = svg(
    "svg",
    { class: "plan", role: "group", "aria-label": "The room from above" },
    rings,
    robot,
    balls,
  );
  let dragged = null;
  let reach = 0;
  let camera = { x_m: 0, y_m: 0, heading_rad: 0 };

  const fit = (places) => {
    const wanted = Math.max(...places.flatMap(({ x_m, y_m }) => [Math.abs(x_m), Math.abs(y_m)])) + 0.4;
    if (wanted <= reach) return;
    reach = REACH_M.find((each) => each >= wanted) ?? wanted;
    element.setAttribute("viewBox", `${-reach} ${-reach} ${2 * reach} ${2 * reach}`);
  };
  const move = (target, x_m, y_m) => {
    const [x, y] = [x_m, y_m].map((each) => Math.max(-reach, Math.min(reach, each)));
    send({ target, x_m: x, y_m: y });
    dragged = { name: target, x_m: x, y_m: y, until: performance.now() + HELD_MS };
    balls.kept?.get(target)?.update(dragged);
  };
  const make = ({ name }) =>
    ball(name, isOurs ? (x_m, y_m) => move(name, x_m, y_m) : null, (target) => tell(target, camera));
  return {
    element,
    update({ targets, camera: seen }) {
      camera = seen ?? camera;
      const [x, y] = place(camera);
      robot.setAttribute("transform", `translate(${x} ${y}) rotate(${(-camera.heading_rad * 180) / Math.PI})`);
      fit([...targets, camera]);
      const isHeld = dragged && performance.now() < dragged.until;
      keyed(
        balls,
        targets.map((target) => (isHeld && target.name === dragged.name ? dragged : target)),
        (target) => target.name,
        make,
      );
    },
  };
}

function ball(name, move, tell) {
  const mark = svg("circle", {
    r: 0.28,
    class: "ball",
    tabindex: move && "0",
    role: move ? "button" : "img",
    "aria-label": `${name} in the room`,
  });
  let at = null;
  mark.update = (target) => {
    at = target;
    const [cx, cy] = place(target);
    mark.setAttribute("cx", cx);
    mark.setAttribute("cy", cy);
    tell(target);
  };
  if (!move) return mark;
  mark.addEventListener("pointerdown", (event) => mark.setPointerCapture(event.pointerId));
  mark.addEventListener("pointermove", (event) => {
    if (!mark.hasPointerCapture(event.pointerId)) return;
    const seen = new DOMPoint(event.clientX, event.clientY).matrixTransform(
      mark.ownerSVGElement.getScreenCTM().inverse(),
    );
    move(-seen.y, -seen.x);
  });
  mark.addEventListener("keydown", (event) => {
    const [dx, dy] = KEYS[event.key] ?? [];
    if (dx === undefined) return;
    event.preventDefault();
    move(at.x_m + dx * STEP_M, at.y_m + dy * STEP_M);
  });
  return mark;
}

/** How far a target is from the camera, and where it has to look. */
function seenFrom(camera, { x_m, y_m }, unit) {
  const [dx, dy] = [x_m - camera.x_m, y_m - camera.y_m];
  const left_rad = Math.atan2(dy, dx) - camera.heading_rad;
  const away = `${format.distance(Math.hypot(dx, dy), 0.01, unit).value} ${unit.symbol} from the camera`;
  return `${away}, ${format.bearing(-Math.atan2(Math.sin(left_rad), Math.cos(left_rad)))}`;
}

/** Sends the newest wish at most every 100 ms, one at a time: a ball that is dragged asks far more often. */
function sender(api, say) {
  let waiting = null;
  let isBusy = false;
  const go = async () => {
    const body = waiting;
    waiting = null;
    isBusy = true;
    try {
      await Promise.all([api.post("world", body), new Promise((done) => setTimeout(done, SEND_MS))]);
    } catch (error) {
      say(error.message, "error");
    }
    isBusy = false;
    if (waiting) go();
  };
  return (body) => {
    waiting = body;
    if (!isBusy) go();
  };
}
