"""Where a ball whose colour is not known is looked for, and in which order."""

from __future__ import annotations

from collections.abc import Iterator

from stadimeter.detectors.ball.choice import RIVAL_SCORE, BestBall
from stadimeter.detectors.ball.circle_votes import CircleProposal, list_octaves, propose_circles
from stadimeter.detectors.ball.circles import ImageCircle
from stadimeter.detectors.ball.gates import BallScene

# A circle that is as much like an outline is measured at once, as half of the silver balls are; of the others so many
# of all octaves, if no ball is sure by then. The third was a ball in one of 230 pictures.
CLEAR_LIKENESS, MAX_UNCLEAR = 14.0, 2


def pick_circles(scene: BallScene, choice: BestBall) -> Iterator[ImageCircle]:
    """Yield the circles of edges that may be a ball; fewer the better the choice is by then."""
    unclear = list[CircleProposal]()
    for octave in list_octaves(scene.image):
        # The largest come first: nothing smaller could be as much like a ball as the best.
        if choice.is_better_than(octave.max_radius_px / RIVAL_SCORE**2):
            break
        proposals = propose_circles(octave)
        yield from (each.circle for each in proposals if each.likeness >= CLEAR_LIKENESS)
        unclear += proposals[:1] if proposals and proposals[0].likeness < CLEAR_LIKENESS else []
    for each in sorted(unclear, key=lambda proposal: -proposal.likeness)[:MAX_UNCLEAR]:
        if not choice.has_sure:
            yield each.circle
