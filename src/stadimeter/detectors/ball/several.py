"""Several balls of one colour: all of them in one search, and each where it is expected."""

from __future__ import annotations

from stadimeter.config.plugins import MAX_SEVERAL
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, Prediction
from stadimeter.core.frame import Frame
from stadimeter.detectors.ball import MAX_SEARCHED_AROUND, BallDetector
from stadimeter.detectors.ball.blobs import find_blobs
from stadimeter.detectors.ball.circle_votes import are_same
from stadimeter.detectors.ball.gates import BallScene, FoundBall, scene_of
from stadimeter.detectors.hsv import HsvRange


class SeveralBalls(BallDetector):
    """Finds every sphere of one colour, as many as there are."""

    @property
    def numbers(self) -> tuple[int, ...]:
        """None: balls are all alike."""
        return ()

    def detect_all(self, frame: Frame, *, lens: CameraModel | None = None) -> tuple[Detection, ...]:
        """Look for every ball of the colour."""
        scene = scene_of(frame, lens, self._gates)
        balls = [] if self._colour is None else self._find_all(scene, self._colour)
        scene.refusals.clear()  # what is left over between balls is not worth a word
        return tuple(self._report_found(scene, ball) for ball in balls) or (self.detect(frame, lens=lens),)

    def detect_near(self, frame: Frame, prediction: Prediction, *, lens: CameraModel | None = None) -> Detection:
        """Look for a ball where it is expected, and nowhere else."""
        scene = scene_of(frame, lens, self._gates)
        found = self._find_expected(scene, prediction)
        return self._refuse("not where it was expected", scene) if found is None else self._report_found(scene, found)

    def _find_all(self, scene: BallScene, colour: HsvRange) -> list[FoundBall]:
        """Return every ball of the colour: one in each blob, then those in what these leave of the blobs.

        Balls that touch are one blob. So what was found is taken out of the mask, until nothing more is found.
        """
        balls: list[FoundBall] = []
        slow_searches = MAX_SEARCHED_AROUND
        while len(balls) < MAX_SEVERAL:
            known = [each.limb.circle for each in balls]
            for blob in find_blobs(scene.image, colour, self._step, without=known, most=MAX_SEVERAL):
                search = self._begin(scene, [blob])
                if search.choice.ball is None and search.large and slow_searches:
                    slow_searches -= 1
                    self._finish(search)
                ball = search.choice.ball
                if ball is not None and not any(are_same(ball.limb.circle, each.limb.circle) for each in balls):
                    balls.append(ball)
            if len(balls) == len(known):
                break
        return balls
