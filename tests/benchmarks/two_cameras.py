"""How well a simulated run measures with two cameras, which boards have calibrated, and what that costs.

Run it by itself: ``python tests/benchmarks/two_cameras.py [RUNS]``.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from msgspec.structs import replace

sys.path.insert(0, str(Path(__file__).parents[1]))

from stadimeter.app.bootstrap import Parts
from stadimeter.core.stereo_rig import UNKNOWNS, StereoRig
from stadimeter.perception.perceiver import Perceiver
from support.stereo import calibrated_rig, true_rig
from support.two_cameras import BASELINE_M, Watched, load

FIRST_SEED = 4100
SIZE_SHARE = 0.005
SECONDS = 2.0


def beside(seed: int) -> StereoRig:
    """Return two cameras whose axes are parallel, as simulated ones are, with lenses that differ."""
    return replace(
        true_rig(seed),
        turn_rad=(0.0, 0.0, 0.0),
        place_m=(BASELINE_M, 0.0, 0.0),
        covariance=np.zeros((UNKNOWNS, UNKNOWNS)),
    )


def path_of(seed: int) -> str:
    """Return a way of half a metre a second, half of it across, somewhere from 0.5 to 3 m away."""
    rng = np.random.default_rng((seed, 41))
    away_m, sign = float(rng.uniform(0.6, 2.6)), 1 if rng.random() < 0.5 else -1
    aside_m = float(rng.uniform(-0.1, 0.1)) * away_m
    places = ((away_m, aside_m), (away_m + 0.35 * sign * (away_m > 1.3) + 0.35 * (away_m <= 1.3), aside_m + 0.1 * sign))
    points = ", ".join(
        f'{{ at = "{at} s", x = "{x:.3f} m", y = "{y:.3f} m" }}' for at, (x, y) in zip((0, 2), places, strict=True)
    )
    return f"path = [{points}]\nloop = false\nseed = {seed}"


def run(folder: Path, seed: int, *, size: str, second: bool = True) -> Watched:
    """Run once: everything errs as it would, the lenses, the pose, the size of the ball, and the noise."""
    true = beside(seed)
    known = calibrated_rig(true, seed)
    diameter_m = 0.12 * float(np.random.default_rng((seed, 42)).normal(1, SIZE_SHARE))
    world = f'=ball_diameter = "{diameter_m} m"\nball_height = "25 cm"\n{path_of(seed)}'
    watched = Watched(load(folder, known, targets_ball=size, world=world), SECONDS)
    _look_through(watched.parts, true)
    if not second:
        watched.parts.cycle.second = None
        watched.parts.cycle.perceiver = Perceiver(watched.parts.cycle.detectors, known.left)
    return watched.run()


def _look_through(parts: Parts, true: StereoRig) -> None:
    """Have the cameras draw through their true lenses, which the configuration does not know."""
    parts.capture._camera._model = true.left
    second = parts.cycle.second
    assert second is not None
    second._capture._camera._model = true.right


def main(runs: int) -> None:
    """Print the figures."""
    sizes = {"and its size": 'tolerance = "0.6 mm"', "size unknown": 'tolerance = "unknown"'}
    with tempfile.TemporaryDirectory() as folder:
        for name, size in (*sizes.items(), ("one camera", sizes["and its size"])):
            errors, sigmas, costs = [], [], []
            looked = Perceiver.look

            def look(*args: object, **kwargs: object) -> object:
                began_s = time.thread_time()
                try:
                    return looked(*args, **kwargs)  # noqa: B023
                finally:
                    costs.append(time.thread_time() - began_s)  # noqa: B023

            Perceiver.look = look  # type: ignore[method-assign, assignment]
            frames = 0
            for seed in range(FIRST_SEED, FIRST_SEED + runs):
                watched = run(Path(folder), seed, size=size, second=name != "one camera")
                of_run = watched.errors()
                errors += of_run[0]
                sigmas += of_run[1]
                frames += len(watched.cycles)
            Perceiver.look = looked  # type: ignore[method-assign]
            holds = np.mean(np.array(sigmas) < 1.96)
            print(
                f"{name:14} {len(errors)} of {frames} frames, median {100 * np.median(errors):.2f} %, "
                f"p95 {100 * np.quantile(errors, 0.95):.2f} %, 95 % interval holds in {100 * holds:.1f} %, "
                f"looking and measuring {1e3 * np.median(costs):.2f} ms of processor time",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
