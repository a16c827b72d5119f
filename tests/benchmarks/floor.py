"""How well what stands on the floor is measured: by its size, by the floor, and by both."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import ours
from part import Part, table
from samples import Sample, Summary, grouped, rate, summarise
from workload import over_seeds

from stadimeter.core.detection import DetectionStatus
from stadimeter.ranging.floor import stand
from stadimeter.ranging.measure import measure
from support.scenes import draw
from support.scenes.on_floor import BALL_M, CARD_M, OnFloorScene, ball_on_floor, sheet_on_floor
from support.scenes.render import render

GROSS = 0.1
DISTANCES_M = (0.5, 1.0, 2.0, 4.0)
SIZE, FLOOR, BOTH = "by size", "by the floor", "both"
METHODS = (SIZE, FLOOR, BOTH)
UNKNOWN_SIZE = 0.03
"""Standard deviation of a size that is not known well, as a share."""

KINDS: dict[str, tuple[str, Callable[[int, float, float], OnFloorScene], float]] = {
    "ball": ("ball", ball_on_floor, 0.0),
    "ball ± 3 %": ("ball", ball_on_floor, UNKNOWN_SIZE),
    "standing A5": ("sheet", sheet_on_floor, 0.0),
}


def run(frames: int, workers: int, first_seed: int = draw.REPORT_SEEDS.start) -> Part:
    """Measure so many scenes of each kind at each distance."""
    samples = over_seeds(samples_of, range(first_seed, first_seed + frames), workers)
    text = (
        f"{frames} balls of 12 cm and sheets of A5, standing on the floor, in each row, before a camera 30 cm ± 3 mm "
        "above it that looks down by 12°, ± 0.1° in tilt and roll, with a focal length known to 0.5 %; the true "
        "figures are drawn with these deviations. Balls are those of the hard world, before wood, concrete and mats. "
        "Sheets are turned by up to 20° and lean by 3° (standard deviation). ± 3 %: the ball's diameter is drawn so, "
        "and said to be. Median / p95 of the relative error in %, and how often the 95 % interval holds.\n\n"
        f"{_rows(samples)}"
    )
    return Part(title="On the floor", text=text, facts=facts_of(samples))


def samples_of(seed: int) -> list[Sample]:
    """Measure one scene of each kind at each distance."""
    return [sample for kind in KINDS for distance_m in DISTANCES_M for sample in _measured(kind, distance_m, seed)]


def _measured(kind: str, distance_m: float, seed: int) -> list[Sample]:
    target, drawn, size_sigma = KINDS[kind]
    on_floor = drawn(seed, distance_m, size_sigma)
    made = render(on_floor.scene)
    sizes = {"width": f"{CARD_M[0]} m", "height": f"{CARD_M[1]} m"}
    if on_floor.hsv is not None:
        sizes = {"diameter": f"{BALL_M} m", "hsv": on_floor.hsv}
    options = sizes | ({"tolerance": f"{size_sigma * BALL_M} m"} if size_sigma else {})
    finder = ours.detector(target, draw.CAMERA, **options)
    # Detectors are built once, so they look through the true lens; what is said of it counts from here on.
    found, shape, camera = finder.detect(ours.framed(made)), finder.target_shape, on_floor.camera
    by_size = measure(found, shape, camera, 0.0)
    stood = stand(by_size, found, shape, camera, on_floor.footing)
    is_found = found.status is DetectionStatus.FOUND
    figures = {
        SIZE: (by_size.distance_m, by_size.sigma_m),
        FLOOR: (stood.distance_m, stood.sigma_m if is_found else None),
        BOTH: (stood.measurement.distance_m, stood.measurement.sigma_m),
    }
    truth = made.truth
    return [
        Sample(
            row=f"{kind}, {distance_m:g} m",
            method=method,
            seed=seed,
            apparent_px=truth.apparent_px,
            true_m=truth.distance_m,
            measured_m=measured_m,
            sigma_m=sigma_m,
        )
        for method, (measured_m, sigma_m) in figures.items()
    ]


def facts_of(samples: Sequence[Sample]) -> dict[str, float]:
    """Return the worst of the cells: of the floor's median, of both against the better, and of the intervals."""
    cells = [_summaries(of_row) for of_row in grouped(samples, lambda sample: sample.row).values()]
    held = [each.coverage for cell in cells for each in (cell[FLOOR], cell[BOTH])]
    return {
        "floor median": max(cell[FLOOR].median for cell in cells),
        "floor both against better": max(
            cell[BOTH].median / min(cell[SIZE].median, cell[FLOOR].median) for cell in cells
        ),
        "floor held least": min(held),
        "floor held most": max(held),
    }


def _summaries(samples: Sequence[Sample]) -> dict[str, Summary]:
    return {method: summarise([each for each in samples if each.method == method], GROSS) for method in METHODS}


def _rows(samples: Sequence[Sample]) -> str:
    head = ("target", "found %", *(f"{method}: error, interval holds %" for method in METHODS))
    rows = []
    for name, of_row in grouped(samples, lambda sample: sample.row).items():
        each = _summaries(of_row)
        found = each[SIZE].found
        counts = {method: sum(one.method == method and one.sigma_m is not None for one in of_row) for method in METHODS}
        cells = (f"{each[method].percents}, {rate(each[method].coverage, counts[method])}" for method in METHODS)
        rows.append((name, f"{100 * found:.0f}", *cells))
    return table(head, rows)
