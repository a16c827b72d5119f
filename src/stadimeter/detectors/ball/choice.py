"""Which of the balls in a picture is taken, and what need not be looked at any more."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.detectors.ball.blobs import Blob
from stadimeter.detectors.ball.circle_votes import are_same
from stadimeter.detectors.ball.circles import ImageCircle
from stadimeter.detectors.ball.colours import learn_colours
from stadimeter.detectors.ball.gates import BallScene, FoundBall, max_score, needed_support
from stadimeter.detectors.ball.limb import Limb, find_limb, near_px

# A ball is no narrower than this share of the blob that shows it, unless that shows more than the ball.
MIN_SHARE_OF_BLOB = 0.7

# While a ball is sure, of a limb elsewhere as much as this must be seen at the first look for a second one by colour.
# In clutter of the ball's colour this takes half the time, and of 240 pictures it changed the error of two, to less.
SEEN_BESIDE_SURE = 0.6

# Greatest number of looks for steps between the ball's colours and others at a doubtful limb, and the least margins of
# its support before the first and the second of them. Of 444 limbs that such looks made a ball's, one had less before
# the first and one before the second; of 9,200 others more than half had.
LOOKS_BY_COLOUR, HOPELESS_AT_FIRST, HOPELESS = 2, -0.3, -0.1

# The same without a colour: of 258 silver balls that a first look found 5 were seen less than is asked for, but of what
# is no ball six in seven things are.
HOPELESS_ANY_COLOUR = 0.0

# A circle of edges that is so near to the ball that was found leads to it again: a share of the radius. With 0.05 it
# took as long, and of a striped ball on video 8 of 759 frames fewer were tracked.
FOUND_SHARE = 0.01

# A look that is supported this well, as a share of the best one, may be right as well.
RIVAL_SHARE = 0.7

# Without a colour: an outline elsewhere with more than this share of the best one's score is as much like a ball.
RIVAL_SCORE = 0.8


class Doubt(NamedTuple):
    """A limb near the circle around a blob that leaves doubt."""

    blob: Blob
    limb: Limb
    reach_px: float  # how far from it steps are looked for
    margin: float  # by how much more of it is seen than is asked for


class BestBall(Struct):
    """The ball that looks most like one so far."""

    ball: FoundBall | None = None

    @property
    def has_sure(self) -> bool:
        """Whether the best ball is beyond doubt."""
        return self.ball is not None and self.ball.is_sure

    def is_better_than(self, radius_px: float) -> bool:
        """Return whether no ball of this radius or less could be better."""
        return self.ball is not None and self.ball.score >= max_score(radius_px)

    def take(self, ball: FoundBall | None) -> None:
        """Take in what was found."""
        if ball is not None and (self.ball is None or ball.score > self.ball.score):
            self.ball = ball

    def beside(self, scene: BallScene) -> BallScene:
        """Return the scene as the rest of it is searched."""
        return scene._replace(found=self.ball)


class RangeSearch(NamedTuple):
    """A search with one range of colours that can go on."""

    scene: BallScene
    large: Sequence[Blob]  # what is looked at, the largest first
    choice: BestBall
    doubts: list[Doubt]  # limbs that need a second look

    def put_off(self, blob: Blob, limb: Limb, reach_px: float) -> None:
        """Leave a second look at a limb for later."""
        self.doubts.append(Doubt(blob, limb, reach_px, _margin(self.scene, limb)))


def best_and_rival(balls: Sequence[FoundBall | None]) -> tuple[FoundBall | None, str]:
    """Return the best of several balls, and the places of it and of another one that is as much like one, in words."""
    ranked = sorted(filter(None, balls), key=lambda each: each.score, reverse=True)
    for rival in ranked[1:]:
        if rival.score > RIVAL_SCORE * ranked[0].score and not are_same(rival.limb.circle, ranked[0].limb.circle):
            circles = (ranked[0].limb.circle, rival.limb.circle)
            return ranked[0], " and ".join(f"{each.x_px:.0f},{each.y_px:.0f}" for each in circles)
    return (ranked[0] if ranked else None), ""


def explains(ball: FoundBall | None, blob: Blob) -> bool:
    """Return whether a blob is a ball beyond doubt, and not something larger that a ball is a part of."""
    return ball is not None and ball.is_sure and ball.limb.circle.radius_px >= MIN_SHARE_OF_BLOB * blob.circle.radius_px


def _margin(scene: BallScene, limb: Limb) -> float:
    """Return by how much more of a limb is seen than is asked for, at best; below zero it is no ball's."""
    return limb.support_inside - needed_support(scene, limb, agrees=scene.expected is not None)


def look_again(scene: BallScene, limb: Limb, reach_px: float) -> Limb:
    """Return a doubtful limb by colour; as it is where that will hardly help, or beside a sure ball."""
    is_any_colour = scene.gates.colour is None and scene.expected is None
    if _margin(scene, limb) < (HOPELESS_ANY_COLOUR if is_any_colour else HOPELESS_AT_FIRST) or (
        scene.found is not None and scene.found.is_sure and limb.support_inside < SEEN_BESIDE_SURE
    ):
        return limb
    # Another range of colours often shows the same blob, and so the same limb.
    if limb.circle not in scene.looks:
        scene.looks[limb.circle] = look_by_colour(scene, limb, reach_px)
    return scene.looks[limb.circle]


def is_found_again(scene: BallScene, circle: ImageCircle) -> bool:
    """Return whether a circle is so near to the ball that was found that it leads to it again."""
    if scene.found is None:
        return False
    ball = scene.found.limb.circle
    off_px = max(abs(circle.x_px - ball.x_px), abs(circle.y_px - ball.y_px), abs(circle.radius_px - ball.radius_px))
    return off_px <= FOUND_SHARE * ball.radius_px


def look_by_colour(scene: BallScene, best: Limb, within_px: float) -> Limb:
    """Return the best supported limb of the first one and those found by colour, and how much they differ."""
    limb, looks = best, [best]
    for _ in range(LOOKS_BY_COLOUR):
        # Colours are learnt anew around each limb that was found: the first one may include a finger or the shadow.
        # Looks by colour brought the 95th percentile of the error on marked balls from 4.6 to 2.8 %, and cost nothing
        # where the first limb is beyond doubt.
        colours = learn_colours(scene.image, limb.circle)
        found = None if colours is None else find_limb(scene.image, limb.circle, within_px, scene.lens, colours)
        if found is None:
            break
        limb, within_px = found, near_px(found)
        looks.append(limb)
        best = limb if limb.worth >= best.worth else best
        if not limb.is_doubtful or max(_margin(scene, each) for each in looks) < HOPELESS:
            break
    # Looks that are nearly as well supported but disagree: their spread becomes part of σ (0.8 of it, see
    # `Limb.radius_sigma_px`).
    radii_px = [each.straight_radius_px for each in looks if each.worth >= RIVAL_SHARE * best.worth]
    return replace(best, change_px=max(radii_px) - min(radii_px))
