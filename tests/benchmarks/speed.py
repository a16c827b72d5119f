"""How long a frame takes, beside what people run today and beside the least that any program must do.

Each time is taken twice, on one thread of OpenCV. Hot: the same work on the same picture again and again, as in a loop
that does nothing else, with code and picture in the processor's cache. Cold: all contenders and pictures in random
order, so that each finds the cache full of another's work, as in a run that also moves, records and publishes.
Absolute times say something about this machine only; ratios travel better.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter

import cv2
import fiducials
import numpy as np
import ours
import tutorial
from msgspec import Struct
from part import Part, table
from workload import one_thread

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.detectors.sampling import light_table
from stadimeter.detectors.tag.search import TagSearch, tag_family
from support.scenes import draw
from support.scenes.render import render
from support.scenes.scene import RenderedScene, Scene

SIZES = ((640, 480), (1280, 720), (1920, 1080))
SIZES_OF = {"ball of any colour": SIZES[:1]}
"""Those of what is not timed at all sizes."""

FOCAL_OF_WIDTH = 600 / 640
SCENES = 8
ROUNDS = 8
HOT_REPEATS = 3
"""In each round, so often in a row after once without looking at the clock."""
TAG_SIDES_PX = (48.0, 64.0, 100.0)

TITLES = {
    "ball": "Ball on clutter; in brackets against the tutorial",
    "ball of any colour": "Ball on clutter, its colour not given; in brackets against the search by colour",
    "sheet": "Sheet on clutter; in brackets against the tutorial",
    "plain sheet": "Sheet before a plain wall; in brackets against the tutorial",
    "disc": "Disc on clutter; in brackets against one pass of HSV + `inRange`",
    "tag": "Tag of 48–100 px on clutter; in brackets against `cv2.aruco`'s defaults",
}
AGAINST = {
    "ball": "tutorial",
    "ball of any colour": "by colour",
    "sheet": "tutorial",
    "plain sheet": "tutorial",
    "disc": "HSV + inRange",
    "tag": "aruco",
}

Size = tuple[int, int]
STATES = ("hot", "cold")

Times = dict[str, dict[str, float]]
"""Median times in microseconds, by state and contender."""

Work = Callable[[int], object]
"""Takes the number of a scene."""


class Contender(Struct, frozen=True, kw_only=True):
    """Something that is timed.

    Attributes:
        name: What it is.
        work: What it does with a scene.
    """

    name: str
    work: Work


def run(rounds: int = ROUNDS, scenes: int = SCENES, first_seed: int = draw.REPORT_SEEDS.start) -> Part:
    """Time everything.

    Args:
        rounds: How often each scene is taken.
        scenes: How many scenes.
        first_seed: The first of them.

    Returns:
        The part of the report.
    """
    one_thread()
    seeds = range(first_seed, first_seed + scenes)
    made: dict[str, Callable[[Size, range], list[Contender]]] = {
        "ball": _ball_contenders,
        "ball of any colour": _any_colour_contenders,
        "sheet": _sheet_contenders,
        "plain sheet": partial(_sheet_contenders, plain=True),
        "disc": _disc_contenders,
        "tag": _tag_contenders,
    }
    times = {
        what: {size: _timed(contenders(size, seeds), rounds, scenes) for size in SIZES_OF.get(what, SIZES)}
        for what, contenders in made.items()
    }
    text = (
        f"Medians of {rounds} rounds over {scenes} scenes, one OpenCV thread ({cv2.__version__}). Hot is the same work "
        "again and again; cold is all contenders and scenes in random order, so that the cache holds another's work. "
        "Ours is detection and measurement together, unless a row says what it is; in brackets how many times faster "
        f"than what is named there. Tracking is told where the target is, to {ours.PREDICTION_SIGMA_PX:g} px.\n"
    )
    for what, by_size in times.items():
        text += f"\n### {TITLES[what]}, µs\n\n{_table(by_size, AGAINST[what])}"
    return Part(title="Speed", text=text, facts=_facts(times))


def _camera(size: Size) -> CameraModel:
    return CameraModel.with_focal_length(FOCAL_OF_WIDTH * size[0], *size)


def _ball_contenders(size: Size, seeds: range) -> list[Contender]:
    camera = _camera(size)
    # Even seeds are tennis balls, so that one detector serves all.
    made = [render(draw.ball_scene(seeds.start + 2 * number, camera)) for number in range(len(seeds))]
    return [
        *_floors(made),
        Contender(name="tutorial", work=lambda number: tutorial.ball_radius_px(made[number].image)),
        *_ours("ball", made, camera),
    ]


def _any_colour_contenders(size: Size, seeds: range) -> list[Contender]:
    camera = _camera(size)
    made = [render(draw.ball_scene(seeds.start + 2 * number, camera)) for number in range(len(seeds))]
    empty = [render(draw.empty_scene(seed)) for seed in seeds]
    by_colour, by_outline = (ours.detector(name, camera) for name in ("ball", "ball of any colour"))
    return [
        *_floors(made),
        Contender(name="by colour", work=lambda number: ours.measure(by_colour, made[number].image)),
        Contender(name="stadimeter", work=lambda number: ours.measure(by_outline, made[number].image)),
        Contender(name="stadimeter, no ball there", work=lambda number: ours.measure(by_outline, empty[number].image)),
    ]


def _sheet_contenders(size: Size, seeds: range, *, plain: bool = False) -> list[Contender]:
    camera = _camera(size)
    made = [render(draw.sheet_scene(seed, 0.5, plain=plain, camera=camera)) for seed in seeds]
    return [
        *_floors(made),
        Contender(name="tutorial", work=lambda number: tutorial.sheet_long_side_px(made[number].image)),
        *_ours("sheet", made, camera),
    ]


def _disc_contenders(size: Size, seeds: range) -> list[Contender]:
    camera = _camera(size)
    made = [render(draw.disc_scene(seed, 0.5, camera=camera)) for seed in seeds]
    return [*_floors(made), *_ours("disc", made, camera)]


def _tag_contenders(size: Size, seeds: range) -> list[Contender]:
    camera = _camera(size)
    scenes = [draw.tag_scene(seed, TAG_SIDES_PX[seed % len(TAG_SIDES_PX)], 0.4, camera) for seed in seeds]
    made = [render(scene) for scene in scenes]
    libraries = [Contender(name=name, work=_library(finder, made)) for name, finder in fiducials.finders().items()]
    return [*_floors(made), *libraries, *_our_tags(scenes, made)]


def _library(finder: fiducials.Finder, made: Sequence[RenderedScene]) -> Work:
    return lambda number: finder(made[number].image)


def _floors(made: Sequence[RenderedScene]) -> list[Contender]:
    """Return what any program must at least do: touch each pixel once; judge the colour of each."""
    copy = np.empty_like(made[0].image)
    return [
        Contender(name="np.copyto", work=lambda number: np.copyto(copy, made[number].image)),
        Contender(name="HSV + inRange", work=lambda number: _in_range(made[number].image)),
    ]


def _in_range(image: Image) -> object:
    return cv2.inRange(cv2.cvtColor(image, cv2.COLOR_BGR2HSV), tutorial.BALL_LOWER, tutorial.BALL_UPPER)


def _ours(target: str, made: Sequence[RenderedScene], camera: CameraModel) -> list[Contender]:
    finder = ours.detector(target, camera)
    predictions = [ours.prediction_of(each.truth) for each in made]
    return [
        Contender(name="stadimeter", work=lambda number: ours.measure(finder, made[number].image)),
        Contender(
            name="stadimeter, tracking",
            work=lambda number: ours.measure(finder, made[number].image, predictions[number]),
        ),
    ]


def _our_tags(scenes: Sequence[Scene], made: Sequence[RenderedScene]) -> list[Contender]:
    camera = scenes[0].camera
    finders = [ours.detector("tag", camera, id=scene.target.number) for scene in scenes]
    predictions = [ours.prediction_of(each.truth) for each in made]
    search = TagSearch(family=tag_family(draw.TAG_FAMILY), light=light_table(camera.tone_curve), min_side_px=16.0)
    return [
        Contender(name="stadimeter", work=lambda number: ours.measure(finders[number], made[number].image)),
        Contender(
            name="stadimeter, tracking: search, sides and pose",
            work=lambda number: ours.measure(finders[number], made[number].image, predictions[number]),
        ),
        Contender(
            name="stadimeter, tracking: search alone",
            work=lambda number: search.around(made[number].image, predictions[number]),
        ),
    ]


def _timed(contenders: Sequence[Contender], rounds: int, scenes: int) -> Times:
    """Return the median time of each contender, hot and cold."""
    for contender in contenders:
        contender.work(0)
    pairs = [(contender, number) for number in range(scenes) for contender in contenders]
    # The hot rounds alternate with the cold ones, so that what slows the machine for a while slows both.
    order = np.random.default_rng(0)
    times: dict[str, dict[str, list[float]]] = {state: {each.name: [] for each in contenders} for state in STATES}
    for _ in range(rounds):
        for contender, number in pairs:
            contender.work(number)
            times["hot"][contender.name] += [_seconds(contender, number) for _ in range(HOT_REPEATS)]
        for contender, number in (pairs[place] for place in order.permutation(len(pairs))):
            times["cold"][contender.name].append(_seconds(contender, number))
    return {
        state: {name: 1e6 * statistics.median(taken) for name, taken in of_state.items()}
        for state, of_state in times.items()
    }


def _seconds(contender: Contender, number: int) -> float:
    began_s = perf_counter()
    contender.work(number)
    return perf_counter() - began_s


def _table(times: dict[Size, Times], against: str) -> str:
    names = list(next(iter(times.values()))["hot"])
    head = ["", *(f"{width}×{height}, {state}" for width, height in times for state in STATES)]
    columns = [of_size[state] for of_size in times.values() for state in STATES]
    rows = [[name, *(f"{each[name]:.0f} ({each[against] / each[name]:.1f}×)" for each in columns)] for name in names]
    return table(head, rows)


def _facts(times: dict[str, dict[Size, Times]]) -> dict[str, float]:
    """Return how many times faster than the others ours is, by target, what is done, and the picture's height.

    A fact is of the hot state unless its name ends with ``cold``.
    """
    facts = {}
    for what, by_size in times.items():
        for (_, height), of_size in by_size.items():
            for state, end in zip(STATES, ("", " cold"), strict=True):
                us = of_size[state]
                for name in us:
                    if name.startswith("stadimeter"):
                        facts[f"{what} {name} {height} speed-up{end}"] = us[AGAINST[what]] / us[name]
                        facts[f"{what} {name} {height} of inRange{end}"] = us[name] / us["HSV + inRange"]
    return facts
