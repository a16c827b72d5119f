"""The search for a ball whose colour is not known, by circles of edges."""

from __future__ import annotations

from stadimeter.detectors.ball.choice import RIVAL_SCORE, BestBall, best_and_rival, look_again
from stadimeter.detectors.ball.circle_votes import list_octaves, propose_circles
from stadimeter.detectors.ball.circles import ImageCircle
from stadimeter.detectors.ball.gates import BallScene, FoundBall, needed_support, refuse_without_limb
from stadimeter.detectors.ball.limb import Limb, find_limb, within

# Number of limbs that leave doubt which are looked at again by colour, which takes several times as long as the first
# look. Of 258 silver balls that this found 5 were seen less at first than is asked for, but of what is no ball six in
# seven things are.
MAX_LOOKED_AGAIN = 2


def find_any_colour(scene: BallScene) -> tuple[FoundBall | None, str]:
    """Return the ball among the circles of edges, and the places of it and of another one that is as much like one."""
    choice, balls, doubts = BestBall(), list[FoundBall](), list[tuple[ImageCircle, Limb]]()

    def take(circle: ImageCircle, limb: Limb | None) -> None:
        judged = refuse_without_limb(circle) if limb is None else scene.gates.judge(scene, limb)
        if isinstance(judged, FoundBall):
            balls.append(judged)
            choice.take(judged)
        else:
            scene.refusals.append(judged)

    for octave in list_octaves(scene.image):
        # The largest come first: nothing smaller could be as much like a ball as the best.
        if choice.is_better_than(octave.max_radius_px / RIVAL_SCORE**2):
            break
        for circle in propose_circles(octave, scene.gates.min_radius_px, scene.gates.max_radius_px):
            limb = find_limb(scene.image, circle, within(circle), scene.lens)
            if limb is not None and limb.is_doubtful and limb.support_inside >= needed_support(scene, limb):
                doubts.append((circle, limb))
            else:
                take(circle, limb)
    doubts.sort(key=lambda each: -each[1].worth)
    for number, (circle, limb) in enumerate(doubts):
        is_tried = number < MAX_LOOKED_AGAIN
        take(circle, look_again(choice.beside(scene), limb, within(circle)) if is_tried else limb)
    return best_and_rival(balls)
