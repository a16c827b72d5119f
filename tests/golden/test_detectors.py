"""What each detector measures in seeded frames, clean and troubled. The order of frames is that of their seeds.

Rendering and OpenCV round a little differently on another processor, and another version of OpenCV finds other edges:
distances are compared within a share of their own standard deviation. `make golden ARGS="-k detectors"` writes only
these files.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import cv2
import pytest

from stadimeter.config.plugins import DETECTORS, DriverContext, load_driver
from stadimeter.core.frame import Frame
from stadimeter.core.measurement import MeasurementStatus
from stadimeter.testing.rig import ManualClock
from support.detector_rigs import poster_file
from support.golden import Golden
from support.scenes import draw
from support.scenes.circles import circles_scene
from support.scenes.nuisances import BALL_NUISANCES, SHEET_NUISANCES, TAG_NUISANCES, Nuisance
from support.scenes.poster import poster_scene
from support.scenes.render import render
from support.scenes.scene import Scene
from support.through_lens import ThroughLens

QUICK = {"ball": 10, "sheet": 10, "disc": 10, "tag": 4, "picture": 2, "circles": 2}
"""So many frames of each kind in the quick test: as many as are drawn in half a second."""
ALL, IN_A_LINE = 340, 10
"""So many of each in the long one, two thousand in all, and how many stand in a line."""

SAME_SIGMAS, OTHER_SIGMAS = 0.02, 0.5
"""By how many of its standard deviations a distance may differ: with the same minor version of OpenCV, and another."""
OTHER_SHARE = 0.1
"""In this share of frames another version of OpenCV may find what this one does not, and the other way round."""

TILTS_DEG = (0, 15, 30, 45, 60)
BALL_HSV = "29,86,6:64,255,255"


def _tilt_rad(seed: int) -> float:
    return math.radians(TILTS_DEG[seed % len(TILTS_DEG)])


def _side_px(seed: int) -> float:
    return 40.0 + 17.0 * (seed % 11)


def _diameter_m(seed: int) -> float:
    return (draw.TENNIS_M, draw.LARGE_BALL_M)[seed % 2]


POSTERS = 3
KINDS: dict[str, tuple[Callable[[int], Scene], Callable[[int], dict[str, Any]], dict[str, Nuisance]]] = {
    "ball": (draw.ball_scene, lambda seed: {"diameter": f"{_diameter_m(seed)} m", "hsv": BALL_HSV}, BALL_NUISANCES),
    "sheet": (
        lambda seed: draw.sheet_scene(seed, _tilt_rad(seed), plain=seed % 2 == 0),
        lambda _: {"width": "29.7 cm", "height": "21 cm"},
        SHEET_NUISANCES,
    ),
    "tag": (
        lambda seed: draw.tag_scene(seed, _side_px(seed), _tilt_rad(seed)),
        lambda _: {"side": "10 cm", "family": draw.TAG_FAMILY},
        TAG_NUISANCES,
    ),
    "disc": (
        lambda seed: draw.disc_scene(seed, _tilt_rad(seed), plain=seed % 2 == 0),
        lambda _: {"diameter": "12 cm"},
        TAG_NUISANCES,
    ),
    "circles": (
        lambda seed: circles_scene(seed, 0.7 * _side_px(seed), _tilt_rad(seed)),
        lambda _: {"diameter": "5 cm", "spacing": "10 cm"},
        TAG_NUISANCES,
    ),
    "picture": (
        lambda seed: poster_scene(seed % POSTERS, 60.0 + _side_px(seed), _tilt_rad(seed)),
        lambda seed: {"width": "40 cm", "file": str(poster_file(seed % POSTERS))},
        TAG_NUISANCES,
    ),
}
"""By the driver: the scene and the options of a seed, and the troubles that go round."""


@pytest.mark.vision
def test_the_first_frames_of_every_kind_are_measured_as_they_were(golden: Golden) -> None:
    rows = {kind: " ".join(_seen(kind, seed) for seed in range(QUICK[kind])) for kind in KINDS}
    _compare(golden, "detectors", rows)


@pytest.mark.long
@pytest.mark.vision
@pytest.mark.timeout(3600)  # two to three minutes of drawing for each kind, on a core that nobody else uses
@pytest.mark.parametrize("kind", KINDS)
def test_two_thousand_frames_are_measured_as_they_were(kind: str, golden: Golden) -> None:
    starts = range(0, ALL, IN_A_LINE)
    rows = {f"from {first}": " ".join(_seen(kind, first + each) for each in range(IN_A_LINE)) for first in starts}
    _compare(golden, f"detectors-{kind}", rows)


def _compare(golden: Golden, name: str, rows: dict[str, str]) -> None:
    """Compare lines of figures: closely by the OpenCV that the file was written with, else as it deserves."""
    version = ".".join(cv2.__version__.split(".")[:2])
    kept_by = golden.kept(name).get("OpenCV", version)
    sigmas, share = (SAME_SIGMAS, 0.0) if kept_by == version else (OTHER_SIGMAS, OTHER_SHARE)

    def is_same(kept: str, now: str) -> bool:
        pairs = list(zip(kept.split(" "), now.split(" "), strict=True))
        return sum(not _is_near(*pair, sigmas) for pair in pairs) <= share * len(pairs)

    golden.compare(name, {"OpenCV": kept_by} | rows, is_same)


def _is_near(kept: str, now: str, sigmas: float) -> bool:
    if "±" not in kept or "±" not in now:
        return kept == now
    (kept_m, sigma_m), (now_m, _) = (map(float, each.rstrip("?").split("±")) for each in (kept, now))
    return abs(kept_m - now_m) <= sigmas * sigma_m


@cache
def _finder(kind: str, options: tuple[tuple[str, Any], ...]) -> ThroughLens:
    context = DriverContext(name="it", clock=ManualClock(), camera_model=draw.CAMERA)
    return ThroughLens(load_driver(DETECTORS, kind).model_validate(dict(options)).build(context), draw.CAMERA)


def _seen(kind: str, seed: int) -> str:
    """Return what is measured in a frame, such as ``1.2345±0.0012``, or why nothing is."""
    scene_of, options_of, troubles = KINDS[kind]
    trouble = tuple(troubles.values())[seed % len(troubles)]
    rendered = render(trouble(scene_of(seed)))
    finder = _finder(kind, tuple(options_of(seed).items()))
    found = finder.measure(Frame(rendered.image, 0.0, 0, subsampling=rendered.subsampling))
    if found.distance_m is None or found.sigma_m is None:
        return str(found.status)
    return f"{found.distance_m:.5g}±{found.sigma_m:.2g}{'?' * (found.status == MeasurementStatus.PERHAPS)}"
