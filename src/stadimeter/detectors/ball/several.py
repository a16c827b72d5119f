"""Several balls of one colour: all of them in one search, and each where it is expected."""

from __future__ import annotations

from stadimeter.config.plugins import MAX_SEVERAL
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Prediction
from stadimeter.core.frame import Frame
from stadimeter.detectors.ball import BallDetector
from stadimeter.detectors.ball.blobs import find_blobs
from stadimeter.detectors.ball.evidence import LIKELY, BallScene, FoundBall
from stadimeter.detectors.ball.search import are_same, search_blobs, search_circles
from stadimeter.detectors.hsv import HsvRange


class SeveralBalls(BallDetector):
    """Finds every sphere of one colour, as many as there are."""

    @property
    def numbers(self) -> tuple[int, ...]:
        """None: balls are all alike."""
        return ()

    def detect_all(self, frame: Frame, *, lens: CameraModel | None = None) -> tuple[Detection, ...]:
        """Look for every ball of the colour."""
        scene = self._scene_of(frame, lens)
        balls = [] if self._colour is None else self._find_all(scene, self._colour)
        scene.seen.clear()  # what is left over between balls is not worth a word
        return tuple(self._report_found(scene, ball) for ball in balls) or (self.detect(frame, lens=lens),)

    def detect_near(self, frame: Frame, prediction: Prediction, *, lens: CameraModel | None = None) -> Detection:
        """Look for a ball where it is expected, and nowhere else."""
        scene = self._scene_of(frame, lens)
        found = self._find_expected(scene, prediction)
        return self._refuse("not where it was expected", scene) if found is None else self._report_found(scene, found)

    def _find_all(self, scene: BallScene, colour: HsvRange) -> list[FoundBall]:
        """Return every ball of the colour: one in each blob, those in what these leave of the blobs, and other circles.

        Balls that touch are one blob. So what was found is taken out of the mask, until nothing more is found.
        """
        balls: list[FoundBall] = []
        while len(balls) < MAX_SEVERAL:
            known = [each.limb.circle for each in balls]
            for blob in find_blobs(scene.image, colour, self._step, without=known, most=MAX_SEVERAL):
                here = scene._replace(seen=[])
                search_blobs(here, [blob])
                _add(balls, here)
            if len(balls) == len(known):
                break
        around = scene._replace(seen=[])
        search_circles(around)
        _add(balls, around)
        return balls[:MAX_SEVERAL]


def _add(balls: list[FoundBall], scene: BallScene) -> None:
    """Add the likely balls of a search that are not known yet, the best first."""
    for ball in scene.ranked:
        circle = ball.limb.circle
        if ball.evidence >= LIKELY and not any(are_same(circle, each.limb.circle) for each in balls):
            balls.append(ball)
