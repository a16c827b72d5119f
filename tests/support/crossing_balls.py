"""Balls that cross each other before the camera, a stand-in for the detector that sees them, and who follows them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.decide import State, decide, initial_state
from stadimeter.core.detection import Detection, DetectionStatus, Prediction
from stadimeter.core.frame import Frame
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from stadimeter.detectors.protocol import Detector
from stadimeter.perception.perceiver import Perceiver
from stadimeter.ranging.ball import BallShape
from stadimeter.simulation.camera import silhouette
from support.scenes.draw import CAMERA

DIAMETER_M = 0.067
RATE_HZ = 30.0

# Standard deviation of a place and of a size in pixels where a ball is seen whole, and how often it is missed.
NOISE_PX, MISSED = 0.15, 0.01

# A ball of which this share is covered is not found; with less, its place and size err by this share of the diameter
# times the covered share.
HIDDEN_SHARE, COVERED_ERROR = 0.5, 0.15

# Samples along a pixel of a rendered ball.
FINER = 4

BLANK = np.zeros((CAMERA.height_px, CAMERA.width_px, 3), np.uint8)

Places = NDArray[np.float64]


class Seen(NamedTuple):
    """A ball as it appears."""

    centre_px: tuple[float, float]
    diameter_px: float
    covered: float  # the share of it that is behind nearer ones


def courses(seed: int, balls: int, seconds: float, *, is_crossing: bool) -> Places:
    """Return where each ball is in each frame, in the camera frame, shape ``(frames, balls, 3)``.

    Each swings on three sines a direction, at up to 1 m/s. Balls that do not cross have a part of the view each.
    """
    rng = np.random.default_rng((seed, 90))
    at_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    places = np.empty((len(at_s), balls, 3))
    for ball in range(balls):
        depth_m = 1.0 + 0.35 * ball + 0.12 * _swing(rng, at_s)
        middle = 0.0 if is_crossing else (ball + 0.5) / balls * 0.9 - 0.45
        reach = 0.4 if is_crossing else 0.3 / balls
        places[:, ball, 0] = depth_m * (middle + reach * _swing(rng, at_s))
        places[:, ball, 1] = depth_m * 0.15 * _swing(rng, at_s)
        places[:, ball, 2] = depth_m
    return places


def _swing(rng: np.random.Generator, at_s: Places) -> Places:
    """Return a value within -1 and 1 that wanders smoothly: periods of 2 to 9 s."""
    waves = [np.sin(2 * math.pi * (at_s / rng.uniform(2, 9) + rng.uniform())) for _ in range(3)]
    return np.asarray(sum(waves) / 3)


def appearances(places_m: Places) -> list[Seen]:
    """Return how the balls of a frame appear."""
    outlines = [silhouette(CAMERA, tuple(place), DIAMETER_M / 2) for place in places_m.tolist()]
    circles = [None if each is None else (each.centre_px, each.half_across_px[0]) for each in outlines]
    seen: list[Seen] = []
    for ball, circle in enumerate(circles):
        if circle is None:  # behind the camera
            seen.append(Seen((math.inf, math.inf), 1.0, 1.0))
            continue
        nearer = [each for other, each in enumerate(circles) if each and _is_before(places_m, other, ball)]
        covered = max((_covered(front, circle) for front in nearer), default=0.0)
        seen.append(Seen((float(circle[0][0]), float(circle[0][1])), 2 * circle[1], covered))
    return seen


def _is_before(places_m: Places, one: int, other: int) -> bool:
    return one != other and float(np.linalg.norm(places_m[one])) < float(np.linalg.norm(places_m[other]))


def _covered(front: tuple[Sequence[float], float], behind: tuple[Sequence[float], float]) -> float:
    """Return the share of a circle's width that one before it covers, along the line through both centres."""
    gap_px = math.dist(front[0], behind[0])
    return min(1.0, max(0.0, (front[1] + behind[1] - gap_px) / (2 * behind[1])))


class PretendBalls:
    """Stands in for the detector: it gives what one would see of balls whose places are known."""

    numbers: tuple[int, ...] = ()

    def __init__(self, places: Places, seed: int) -> None:
        self.target_shape = BallShape(diameter_m=DIAMETER_M)
        self._rng = np.random.default_rng((seed, 91))
        self._places = places
        self._frame = -1
        self._seen: list[Detection] = []

    def detect(self, frame: Frame, prediction: Prediction | None = None, *, lens: object = None) -> Detection:
        """Return any."""
        return self.detect_all(frame, lens=lens)[0]

    def detect_all(self, frame: Frame, *, lens: object = None) -> tuple[Detection, ...]:
        """Return all that are in sight, in no order."""
        if frame.sequence != self._frame:
            self._frame = frame.sequence
            seen = [each for each in appearances(self._places[frame.sequence]) if self._is_found(each)]
            self._seen = [self._noisy(seen[index]) for index in self._rng.permutation(len(seen))]
        return tuple(self._seen) or (Detection(target="balls", status=DetectionStatus.NOT_FOUND, reason="none"),)

    def detect_near(self, frame: Frame, prediction: Prediction, *, lens: object = None) -> Detection:
        """Return the one that is nearest to the prediction, if it is as near as the real detector looks."""
        self.detect_all(frame)
        reach_px = 4 * prediction.sigma_px + 8
        near = [each for each in self._seen if math.dist(each.centre_px, prediction.centre_px) <= reach_px]
        missing = Detection(target="balls", status=DetectionStatus.NOT_FOUND, reason="not there")
        return min(near, key=lambda each: math.dist(each.centre_px, prediction.centre_px), default=missing)

    def _is_found(self, seen: Seen) -> bool:
        return seen.covered < HIDDEN_SHARE and self._rng.random() >= MISSED

    def _noisy(self, seen: Seen) -> Detection:
        sigma_px = math.hypot(NOISE_PX, COVERED_ERROR * seen.covered * seen.diameter_px)
        dx, dy, dsize = self._rng.normal(0, sigma_px, 3)
        size_px = max(1.0, seen.diameter_px + dsize)
        return Detection(
            target="balls",
            status=DetectionStatus.FOUND,
            centre_px=(seen.centre_px[0] + dx, seen.centre_px[1] + dy),
            width_px=size_px,
            height_px=size_px,
            size_sigma_px=sigma_px,
            quality=1.0,
            outline_px=np.zeros((0, 2)),
            measured_with=CAMERA,
        )


class Follower:
    """Follows balls from frame to frame, as a run does, and notes when two of them change places."""

    def __init__(self, detector: Detector, balls: int) -> None:
        names = tuple(f"balls-{number}" for number in range(1, balls + 1))
        self._perceiver = Perceiver(dict.fromkeys(names, detector), CAMERA)
        self.state: State = initial_state(Plan(targets=names))
        self.ball_of: dict[str, int] = {}
        self.swaps = 0
        self.tracked = 0
        self.detections: tuple[Detection, ...] = ()

    def step(self, image: NDArray[np.uint8], number: int, truth: Sequence[Seen]) -> None:
        """Take in a frame."""
        at_s = number / RATE_HZ
        frame = Frame(image, at_s, number)
        tracks = {each.track.target: each.track for each in self.state.tracks}
        self.detections, measurements = self._perceiver.look(frame, tracks)
        stamp = FrameStamp(sequence=number, captured_at_s=at_s)
        self.state, _ = decide(self.state, Observation(now_s=at_s, frame=stamp, measurements=measurements))
        valid = {each.track.target for each in self.state.tracks if each.track.is_valid}
        seen: set[int] = set()
        for found in self.detections:
            if found.status is not DetectionStatus.FOUND or found.target not in valid:
                continue
            ball = self._ball_at(found, truth)
            if ball is None:
                continue
            seen.add(ball)
            before = self.ball_of.get(found.target)
            if before is not None and before != ball:
                self.swaps += 1
            self.ball_of[found.target] = ball
        self.tracked += len(seen)

    @staticmethod
    def _ball_at(found: Detection, truth: Sequence[Seen]) -> int | None:
        """Return which ball a detection is of: its centre is within a quarter of the diameter, the nearest fit."""

        def off(ball: int) -> float:
            each = truth[ball]
            size = abs(found.width_px - each.diameter_px) / each.diameter_px
            return math.dist(found.centre_px, each.centre_px) / each.diameter_px + size

        best = min(range(len(truth)), key=off)
        return best if off(best) < 0.25 else None
