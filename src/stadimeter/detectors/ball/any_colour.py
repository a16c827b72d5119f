"""The search for a ball whose colour is not known, by circles of edges."""

from __future__ import annotations

from stadimeter.detectors.ball.choice import RIVAL_SCORE, BestBall, best_and_rival, look_again
from stadimeter.detectors.ball.circle_votes import Proposal, list_octaves, propose_circles
from stadimeter.detectors.ball.circles import ImageCircle
from stadimeter.detectors.ball.gates import BallScene, FoundBall, needed_support, refuse_without_limb
from stadimeter.detectors.ball.limb import Limb, find_limb, within

# A circle that is as much like an outline is measured at once, as half of the silver balls are; of the others so many
# of all octaves, if no ball is sure by then. The third was a ball in one of 230 pictures.
CLEAR_LIKENESS, MAX_UNCLEAR = 14.0, 2

# Number of limbs that leave doubt which are looked at again by colour, which takes several times as long as the first
# look. Of 258 silver balls that this found 5 were seen less at first than is asked for, but of what is no ball six in
# seven things are.
MAX_LOOKED_AGAIN = 2


def find_any_colour(scene: BallScene) -> tuple[FoundBall | None, str]:
    """Return the ball among the circles of edges, and the places of it and of another one that is as much like one."""
    search, unclear = _OutlineSearch(scene), list[Proposal]()
    for octave in list_octaves(scene.image):
        # The largest come first: nothing smaller could be as much like a ball as the best.
        if search.choice.is_better_than(octave.max_radius_px / RIVAL_SCORE**2):
            break
        for proposal in propose_circles(octave, scene.gates.min_radius_px, scene.gates.max_radius_px):
            if proposal.likeness >= CLEAR_LIKENESS:
                search.look_at(proposal.circle)
            else:
                unclear.append(proposal)
    for proposal in sorted(unclear, key=lambda each: -each.likeness)[:MAX_UNCLEAR]:
        if not search.choice.beside(scene).has_sure:
            search.look_at(proposal.circle)
    search.settle_doubts()
    return best_and_rival(search.balls)


class _OutlineSearch:
    """Circles that were looked at, and what they came to."""

    def __init__(self, scene: BallScene) -> None:
        self.choice = BestBall()
        self.balls: list[FoundBall] = []
        self._scene = scene
        self._doubts: list[tuple[ImageCircle, Limb]] = []

    def look_at(self, circle: ImageCircle) -> None:
        """Take in the limb near a circle, now or, if it leaves doubt, once the doubts are settled."""
        limb = find_limb(self._scene.image, circle, within(circle), self._scene.lens)
        if limb is not None and limb.is_doubtful and limb.support_inside >= needed_support(self._scene, limb):
            self._doubts.append((circle, limb))
        else:
            self._take(circle, limb)

    def settle_doubts(self) -> None:
        """Take in what left doubt, the best of it after a second look."""
        self._doubts.sort(key=lambda each: -each[1].worth)
        for number, (circle, limb) in enumerate(self._doubts):
            is_tried = number < MAX_LOOKED_AGAIN
            beside = self.choice.beside(self._scene)
            self._take(circle, look_again(beside, limb, within(circle)) if is_tried else limb)

    def _take(self, circle: ImageCircle, limb: Limb | None) -> None:
        judged = refuse_without_limb(circle) if limb is None else self._scene.gates.judge(self._scene, limb)
        if isinstance(judged, FoundBall):
            self.balls.append(judged)
            self.choice.take(judged)
        else:
            self._scene.refusals.append(judged)
