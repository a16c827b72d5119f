"""How well the size of a thing is learnt from how it grows while the camera moves by steps that are known roughly.

Each sequence has three pictures: at the beginning, half way and at the end. Its steps err as `ERRORS` says, with one
error of scale for the sequence as the wheels of a robot have it; so does the focal length. The detector is not told
how large the thing is.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import ours
from msgspec.structs import replace
from part import Part, table
from samples import OURS, Sample, grouped, rate, summarise
from workload import over_seeds

from stadimeter.detectors.protocol import Detector
from stadimeter.errors import CalibrationError
from stadimeter.ranging.measure import SeenTarget, measure
from stadimeter.ranging.size_from_motion import StepErrors, StepView, learn_size, view_of
from support.scenes import draw
from support.scenes.backdrop import ClutterBackdrop, PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.plane import DiscTarget, Pose, SheetTarget, TagTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.scenes.target import Target

STARTS_M, WAYS_M = (1.0, 2.0, 4.0), (0.2, 0.5, 1.0)
GOAL_START_M, GOAL_WAY_M = 2.0, 0.5
KINDS = ("ball", "disc", "sheet", "tag")
TABLED = "ball"
"""The kind that is measured over all starts and ways; the others at the goal's."""

ERRORS = StepErrors(scale_share=0.02, place_m=0.002, turn_rad=math.radians(0.5))
FOCAL_SHARE = 0.003
ASSUMED_M = 0.1
SIZES_M = (0.12, 0.25)
TILT_MAX_RAD = math.radians(30)
GROSS = 0.3

OPTIONS: dict[str, dict[str, Any]] = {
    "ball": {"diameter": "10 cm", "hsv": ours.BALL_HSV},
    "disc": {"diameter": "10 cm"},
    "sheet": {"width": "14.1 cm", "height": "10 cm"},
    "tag": {"side": "10 cm", "family": draw.TAG_FAMILY},
}


def run(frames: int, workers: int, first_seed: int = draw.REPORT_SEEDS.start) -> Part:
    """Learn the size in so many sequences a cell."""
    samples = over_seeds(samples_of, range(first_seed, first_seed + frames), workers)
    text = (
        f"{frames} sequences of three pictures in each row, 640×480 px, f = 600 px known to {FOCAL_SHARE:.1%}: balls "
        f"before clutter, and flat things before a plain wall, tilted by up to 30°, of {100 * SIZES_M[0]:.0f}–"
        f"{100 * SIZES_M[1]:.0f} cm, which the detector takes for 10 cm. The way is known to "
        f"{ERRORS.scale_share:.0%} as a whole and to {1000 * ERRORS.place_m:.0f} mm at each place, its direction to "
        f"{math.degrees(ERRORS.aim_rad):.0f}°, and the camera turns by {math.degrees(ERRORS.turn_rad):.1f}° from "
        "picture to picture. 1 m from 1 m away is backwards.\n\n"
    )
    rows = []
    for name, of_row in grouped(samples, lambda sample: sample.row).items():
        each = summarise(of_row, GROSS)
        answered = [one.sigma_m / one.measured_m for one in of_row if one.measured_m and one.sigma_m]
        stated = f"{100 * float(np.median(answered)):.1f}" if answered else "–"
        held = rate(each.coverage, len(answered))
        rows.append((name, str(each.count), each.percents, stated, held, f"{100 * (1 - each.found):.1f}"))
    head = (
        "thing, start, way",
        "sequences",
        "median / p95 %",
        "stated ± %",
        "95 % interval holds %",
        "refused or missed %",
    )
    return Part(title="Things of unknown size", text=text + table(head, rows), facts=_facts(samples))


def _facts(samples: list[Sample]) -> dict[str, float]:
    facts = {}
    for kind in KINDS:
        of_goal = summarise([each for each in samples if each.row == row_of(kind, GOAL_START_M, GOAL_WAY_M)], GROSS)
        facts |= {f"unknown size {kind}": of_goal.median, f"unknown size {kind} held": of_goal.coverage}
    return facts


def row_of(kind: str, start_m: float, way_m: float) -> str:
    """Return the name of a row."""
    return f"{kind}, {start_m:g} m, {way_m:g} m"


def samples_of(seed: int) -> list[Sample]:
    """Learn the size of one thing of each kind from each start, over each way."""
    found = []
    for index, kind in enumerate(KINDS):
        starts = STARTS_M if kind == TABLED else (GOAL_START_M,)
        for start_m in starts:
            rng = np.random.default_rng((seed, 40 + index, round(10 * start_m)))
            found += _Sequence(kind, start_m, seed, rng).samples(WAYS_M if kind == TABLED else (GOAL_WAY_M,))
    return found


class _Sequence:
    """A thing and a camera that moves towards it; pictures that several ways share are made once."""

    def __init__(self, kind: str, start_m: float, seed: int, rng: np.random.Generator) -> None:
        self._kind, self._start_m, self._seed, self._rng = kind, start_m, seed, rng
        self._size_m = float(rng.uniform(*SIZES_M))
        x, y = rng.uniform((-0.08, -0.05), (0.08, 0.05)) * start_m
        self._place_m = np.array((x, y, start_m))
        self._pose = {
            "tilt_rad": float(rng.uniform(0, TILT_MAX_RAD)),
            "tilt_towards_rad": float(rng.uniform(0, 2 * math.pi)),
            "roll_rad": float(rng.uniform(-0.3, 0.3)),
        }
        grey = int(rng.integers(40, 111))
        wall = PlainBackdrop(bgr=(grey, grey + 5, grey + 10))
        self._backdrop = ClutterBackdrop() if kind == "ball" else wall
        self._scale = 1 + ERRORS.scale_share * rng.normal()
        self._aim = ERRORS.aim_rad * rng.normal(size=3)
        focal_px = draw.CAMERA.fx_px * (1 + FOCAL_SHARE * rng.normal())
        self._believed = replace(draw.CAMERA, fx_px=focal_px, fy_px=focal_px, focal_relative_sigma=FOCAL_SHARE)
        self._views: dict[float, StepView | None] = {}

    def samples(self, ways_m: tuple[float, ...]) -> list[Sample]:
        """Return a sample for each way."""
        return [self._sample(way_m) for way_m in ways_m]

    def _sample(self, way_m: float) -> Sample:
        end_m = -way_m if way_m >= self._start_m else way_m
        views = [self._view(moved_m) for moved_m in (0.0, end_m / 2, end_m)]
        measured_m = sigma_m = None
        if all(views):
            try:
                made = learn_size([each for each in views if each], self._believed, ERRORS)
                measured_m, sigma_m = made.factor * ASSUMED_M, made.sigma_share * made.factor * ASSUMED_M
            except CalibrationError:
                pass
        return Sample(
            row=row_of(self._kind, self._start_m, way_m),
            method=OURS,
            seed=self._seed,
            apparent_px=draw.CAMERA.fx_px * self._size_m / self._start_m,
            true_m=self._size_m,
            measured_m=measured_m,
            sigma_m=sigma_m,
        )

    def _view(self, ahead_m: float) -> StepView | None:
        if ahead_m not in self._views:
            self._views[ahead_m] = self._look(ahead_m)
        return self._views[ahead_m]

    def _look(self, ahead_m: float) -> StepView | None:
        moved_m = np.array((0.0, 0.0, ahead_m))
        truly_m = self._scale * (moved_m + np.cross(self._aim, moved_m)) + ERRORS.place_m * self._rng.normal(size=3)
        there_m = self._place_m - truly_m
        there_m += np.cross(ERRORS.turn_rad * self._rng.normal(size=3), there_m)
        scene = Scene(
            camera=draw.CAMERA,
            target=self._target(tuple(there_m.tolist())),
            seed=int(self._rng.integers(1 << 30)),
            backdrop=self._backdrop,
        )
        detector = _detector(self._kind)
        found = detector.detect(ours.framed(render(scene)), lens=self._believed)
        shape = detector.target_shape
        seen = SeenTarget(detection=found, measurement=measure(found, shape, self._believed, 0.0), shape=shape)
        return view_of(f"{ahead_m:g} m", seen, self._believed, (0.0, 0.0, ahead_m))

    def _target(self, position_m: tuple[float, float, float]) -> Target:
        if self._kind == "ball":
            return BallTarget(position_m=position_m, diameter_m=self._size_m)
        pose = Pose(position_m=position_m, **self._pose)
        if self._kind == "disc":
            return DiscTarget(pose=pose, diameter_m=self._size_m)
        if self._kind == "sheet":
            return SheetTarget(pose=pose, width_m=1.41 * self._size_m, height_m=self._size_m)
        return TagTarget(pose=pose, side_m=self._size_m, family=draw.TAG_FAMILY, number=self._seed % draw.TAGS)


@cache
def _detector(kind: str) -> Detector:
    return ours.detector(f"{kind} of unknown size", None, **OPTIONS[kind]).detector
