"""People who walk to and fro before a camera whose sensor finds their boxes, with the errors that such boxes have."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stadimeter.config.plugins import DriverContext
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame, SensorBoxes
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from stadimeter.detectors.object import ObjectOptions
from stadimeter.perception.perceiver import Perceiver
from stadimeter.testing.rig import ManualClock

CAMERA = CameraModel.with_focal_length(1000.0, 1280, 720)
BLANK = np.zeros((CAMERA.height_px, CAMERA.width_px, 3), np.uint8)
HEIGHT_M, SPREAD_M, EYE_M = 1.72, 0.08, 1.2

INPUT_PX = 416.0
"""The longer side of the network's input."""

SHARE, SIGMA_PX, MISSED = 0.035, 1.5, 0.03
"""Errors of a box's sides: as a share of the height, and in pixels of the input; and how often there is none."""

WIDE, HIDDEN_SHARE = 0.38, 0.55
"""How wide people are, as a share of their height; one of whom more is covered has no box."""


class Person(NamedTuple):
    """A person as they are, and appear."""

    x_px: float
    y_px: float
    height_px: float
    distance_m: float


class Crossing:
    """A scene of two or more people, and who is taken for whom in it.

    Args:
        places: Where each is in each frame instead of walking to and fro: x and z in metres, shape ``(frames, people,
            2)``; behind the camera for out of sight.
        names: How many names there are; one for each without it.

    Attributes:
        changes: How often a name went from one person to another.
        crossings: How often the first two changed sides.
        errors: Of each distance that was tracked, its error and its standard deviation, as shares.
    """

    def __init__(
        self,
        seed: int,
        seconds: float,
        rate_hz: float = 10.0,
        people: int = 2,
        *,
        places: NDArray[np.float64] | None = None,
        names: int | None = None,
    ) -> None:
        self._rng = np.random.default_rng((seed, 45))
        at_s = np.arange(round(seconds * rate_hz)) / rate_hz
        self.heights_m = self._rng.normal(HEIGHT_M, SPREAD_M, people)
        courses = [self._course(number, at_s) for number in range(people)]
        self._places = np.stack(courses, axis=1) if places is None else places
        self._at_s = at_s
        self.names = tuple(f"people-{number}" for number in range(1, (names or people) + 1))
        self.reasons: set[str] = set()
        self.changes = self.crossings = self.seen = self.boxes = 0
        self.errors: list[tuple[float, float]] = []
        self.who: dict[str, int] = {}

    def _course(self, number: int, at_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return x and z of a person: each swings on three sines, about 1 m/s, and each farther away than the last."""

        def swing() -> NDArray[np.float64]:
            waves = [np.sin(2 * math.pi * (at_s / self._rng.uniform(4, 14) + self._rng.uniform())) for _ in range(3)]
            return np.asarray(sum(waves) / 3)

        return np.stack([2.0 * swing(), 4.2 + 1.5 * number + 0.7 * swing()], axis=1)

    def run(self) -> None:
        """Follow everybody to the end."""
        options = {"class": "person", "height": "1.72 m ± 8 cm", "count": len(self.names), "every": "0.2 s"}
        detector = ObjectOptions.model_validate(options).build(DriverContext(name="people", clock=ManualClock()))
        perceiver = Perceiver(dict.fromkeys(self.names, detector), CAMERA)
        state = initial_state(Plan(targets=self.names))
        left = None
        for number, now_s in enumerate(self._at_s.tolist()):
            people = self._people(number)
            self.crossings += left not in {None, people[0].x_px < people[1].x_px}
            left = people[0].x_px < people[1].x_px
            tracks = {each.track.target: each.track for each in state.tracks}
            found, measured = perceiver.look(Frame(BLANK, now_s, number, boxes=self._boxes(people)), tracks)
            stamp = FrameStamp(sequence=number, captured_at_s=now_s)
            state, _ = decide(state, Observation(now_s=now_s, frame=stamp, measurements=measured))
            self.reasons |= {each.reason for each in found}
            for each, track in ((each, state.tracks[self.names.index(each.target)].track) for each in found):
                if track.is_valid and each.status is DetectionStatus.FOUND:
                    self._note(each, people, (track.distance_m or 0.0, track.sigma_m or 0.0))

    def _people(self, number: int) -> list[Person]:
        focal_px, middle = CAMERA.fx_px, (CAMERA.width_px / 2, CAMERA.height_px / 2)
        return [
            Person(
                middle[0] + focal_px * x / z,
                middle[1] + focal_px * (EYE_M - height_m / 2) / z,
                focal_px * height_m / z,
                math.hypot(x, z, EYE_M - height_m / 2),
            )
            for (x, z), height_m in zip(self._places[number].tolist(), self.heights_m.tolist(), strict=True)
        ]

    def _boxes(self, people: list[Person]) -> SensorBoxes:
        """Return the boxes of those who are in sight, in no order; of one partly covered, of what is left to see."""
        found, nearer = [], []
        for each in sorted(people, key=lambda person: person.distance_m):
            if each.height_px <= 0:
                continue
            half = WIDE * each.height_px / 2
            left, right = each.x_px - half, each.x_px + half
            covered = max((min(right, high) - max(left, low) for low, high in nearer), default=0.0) / (right - left)
            for low, high in nearer:
                if covered > 0.15 and low < right and high > left and covered < HIDDEN_SHARE:
                    left, right = (
                        (left, min(right, low + half / 2)) if left < low else (max(left, high - half / 2), right)
                    )
            nearer.append((each.x_px - half, each.x_px + half))
            if covered < HIDDEN_SHARE and self._rng.random() >= MISSED:
                sigma_px = math.hypot(SHARE * each.height_px, SIGMA_PX * CAMERA.width_px / INPUT_PX) / math.sqrt(2)
                top, bottom = each.y_px - each.height_px / 2, each.y_px + each.height_px / 2
                found.append(np.array((left, top, right, bottom)) + self._rng.normal(0, sigma_px, 4))
        self.boxes += len(found)
        self._rng.shuffle(found)
        corners = np.array(found).reshape(-1, 4)
        return SensorBoxes(corners, np.full(len(corners), 0.9), ("person",) * len(corners), INPUT_PX)

    def _note(self, found: Detection, people: list[Person], distance: tuple[float, float]) -> None:
        """Note who it is, where that is beyond doubt."""
        off = [
            math.hypot(found.centre_px[0] - each.x_px, found.centre_px[1] - each.y_px) / each.height_px
            + abs(math.log(found.height_px / each.height_px))
            if each.height_px > 0
            else math.inf
            for each in people
        ]
        who, *others = np.argsort(off).tolist()
        self.seen += 1
        if off[who] > 0.25 or off[others[0]] - off[who] < 0.15:
            return
        self.changes += self.who.get(found.target, who) != who
        self.who[found.target] = who
        self.errors.append((distance[0] / people[who].distance_m - 1, distance[1] / distance[0]))
