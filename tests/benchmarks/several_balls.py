"""Several balls of one colour: how often two of them change places in the tracks.

Balls wander about before the camera, on courses that follow from a seed, each at a depth of its own that
changes. The real `Perceiver` and the real tracks follow them. Either a stand-in for the detector gives what one would
see (places with noise, single misses, nothing of a ball that is covered by half, a worse place and size where less is
covered), or the pictures are rendered and the real detector looks. A swap is counted when the target that was one ball
becomes another one.

`python tests/benchmarks/several_balls.py --tuning` is for work on the assignment.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from stadimeter.app.clock import SteppedClock
from stadimeter.config.plugins import DriverContext
from stadimeter.detectors.ball import BallDetector, BallOptions
from stadimeter.detectors.protocol import Detector
from support.crossing_balls import (
    BLANK,
    DIAMETER_M,
    HIDDEN_SHARE,
    Follower,
    PretendBalls,
    appearances,
    courses,
    picture_of,
)
from support.scenes.draw import REPORT_SEEDS, TUNING_SEEDS

HSV = "29,86,6:64,255,255"


class Identities(NamedTuple):
    """What became of the identities in some runs."""

    crossings: int  # how often one ball came to cover another
    swaps: int
    minutes: float
    tracked: float  # the share of balls in view that were tracked, each to a target of its own


def count_swaps(
    seeds: Sequence[int], seconds: float, *, balls: int = 4, is_crossing: bool = True, is_rendered: bool = False
) -> Identities:
    """Follow balls on the courses of some seeds."""
    crossings = swaps = tracked = visible = 0
    for seed in seeds:
        places = courses(seed, balls, seconds, is_crossing=is_crossing)
        detector: Detector = several(balls) if is_rendered else PretendBalls(places, seed)
        follower = Follower(detector, balls)
        was_covered = [False] * balls
        for number, place in enumerate(places):
            truth = appearances(place)
            image = picture_of(place, seed, number) if is_rendered else BLANK
            follower.step(image, number, truth)
            covered = [each.covered >= HIDDEN_SHARE for each in truth]
            crossings += sum(now and not before for now, before in zip(covered, was_covered, strict=True))
            visible += balls - sum(covered)
            was_covered = covered
        swaps += follower.swaps
        tracked += follower.tracked
    return Identities(crossings, swaps, len(seeds) * seconds / 60, tracked / visible)


def several(count: int | None) -> BallDetector:
    """Return the real detector, for a number of balls; for one if that is None."""
    options = BallOptions.model_validate({"diameter": f"{DIAMETER_M} m", "hsv": HSV, "count": count})
    detector: BallDetector = options.build(DriverContext(name="balls", clock=SteppedClock()))
    return detector


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tuning", action="store_true")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rendered", type=int, default=0, metavar="SEEDS")
    given = parser.parse_args()
    first = (TUNING_SEEDS if given.tuning else REPORT_SEEDS)[0]
    seeds = range(first, first + given.seeds)
    told: dict[str, Callable[[], object]] = {
        "apart": lambda: count_swaps(seeds, given.seconds, is_crossing=False),
        "crossing": lambda: count_swaps(seeds, given.seconds),
    }
    if given.rendered:
        few = range(first, first + given.rendered)
        told["rendered, crossing"] = lambda: count_swaps(few, given.seconds, is_rendered=True)
    for name, figures in told.items():
        print(name, figures(), flush=True)


if __name__ == "__main__":
    main()
