// The simulated room of a set-up: its ball is put nearer or farther, as a hand would.

import { h } from "../../dom.js";
import { distance } from "../../format.js";

/** Controls that move the ball; nothing for a real camera. */
export function room(setup) {
  const x_m = setup.picture.ball_m;
  if (!setup.state.answers.some(({ key, answer }) => key === "camera" && answer.startsWith("simulated"))) return null;
  const ahead = h("input", {
    type: "range",
    min: 0.4,
    max: 6,
    step: 0.1,
    value: x_m,
    "aria-label": "Distance of the simulated ball in metres",
    oninput: () => move(Number(ahead.value)),
  });
  const inUnit = (x) => distance(x, null, { ...setup.context.unit, decimals: 1 }).text;
  const told = h("output", null, inUnit(x_m));
  const move = async (x) => {
    told.value = inUnit(x);
    try {
      await setup.api.post("setup/world", { x_m: x, y_m: 0 });
      setup.picture.ball_m = x;
    } catch (error) {
      setup.context.say(error.message, "error");
    }
  };
  return h(
    "label",
    { class: "field setup-room" },
    h("span", null, "The middle of the simulated ball is at ", told),
    ahead,
  );
}
