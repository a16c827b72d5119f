"""How well the distance of a tag is measured, and how small a tag is still read, beside the usual libraries."""

from __future__ import annotations

import math
from functools import cache

import fiducials
import ours
from part import Part, table
from samples import OURS, Sample, grouped, ours_of, summarise
from workload import over_seeds

from support.scenes import draw
from support.scenes.nuisances import CAMERA_NUISANCES, TAG_NUISANCES
from support.scenes.render import render
from support.scenes.scene import RenderedScene, Scene

GROSS = 0.3
SIZES_PX = (12, 16, 20, 24, 32, 48, 64, 100, 150, 200)
TROUBLED_SIZES_PX = (24, 48, 100)
TILTS_DEG = (0, 20, 40, 60)
CAMERA_SIZE_PX = 100
CAMERAS_EVERY = 3
"""Of so many times all tilts, one is seen through other cameras too."""

OTHER_CAMERA = "other camera: "


def run(frames: int, workers: int, first_seed: int = draw.REPORT_SEEDS.start) -> Part:
    """Measure so many tags of each size, and of some sizes under each trouble."""
    samples = over_seeds(samples_of, range(first_seed, first_seed + frames), workers)
    methods = list(grouped(samples, lambda sample: sample.method))
    assumed = [sample for sample in samples if not sample.row.startswith(OTHER_CAMERA)]
    others = [sample for sample in samples if sample.row.startswith(OTHER_CAMERA)]
    text = (
        f"{frames} tags of AprilTag 36h11 in each row, 10 cm, tilted by 0, 20, 40 and 60° in turn, on clutter. A row's "
        "size is the side of the black square as if it were not tilted. The libraries' corners go through "
        "`IPPE_SQUARE`. Median / p95 of the relative error in %, and in brackets the share that was read.\n\n"
        + _table(assumed, methods)
        + f"\nCameras that differ from what is assumed of them; {CAMERA_SIZE_PX} px:\n\n"
        + _table(others, methods)
    )
    return Part(title="Tag", text=text, facts=_facts(assumed))


def samples_of(seed: int) -> list[Sample]:
    """Measure one tag in every row."""
    found = []
    for name, scene in _scenes(seed).items():
        made = render(scene)
        for method, finder in _finders().items():
            corners = finder(made.image).get(scene.target.number)
            measured = None if corners is None else fiducials.range_m(corners, draw.TAG_M, scene.camera)
            found.append(
                Sample(
                    row=name,
                    method=method,
                    seed=seed,
                    apparent_px=made.truth.apparent_px,
                    true_m=made.truth.distance_m,
                    measured_m=measured,
                )
            )
        found += _ours(name, scene, made)
    return found


def _ours(row: str, scene: Scene, made: RenderedScene) -> list[Sample]:
    detector = ours.detector("tag", scene.camera, id=scene.target.number)
    return [ours_of(row, scene.seed, made.truth, ours.measure(detector, made))]


@cache
def _finders() -> dict[str, fiducials.Finder]:
    return fiducials.finders()


def _scenes(seed: int) -> dict[str, Scene]:
    tilt = math.radians(TILTS_DEG[seed % len(TILTS_DEG)])
    scenes = {f"{size} px": draw.tag_scene(seed, size, tilt) for size in SIZES_PX}
    for name, nuisance in TAG_NUISANCES.items():
        if name != "clean":
            scenes |= {f"{size} px {name}": nuisance(scenes[f"{size} px"]) for size in TROUBLED_SIZES_PX}
    if seed // len(TILTS_DEG) % CAMERAS_EVERY == 0:
        still = scenes[f"{CAMERA_SIZE_PX} px"]
        scenes |= {f"{OTHER_CAMERA}{name}": nuisance(still) for name, nuisance in CAMERA_NUISANCES.items()}
    return scenes


def _table(samples: list[Sample], methods: list[str]) -> str:
    rows = []
    for name, of_row in grouped(samples, lambda sample: sample.row).items():
        summaries = [summarise([s for s in of_row if s.method == method], GROSS) for method in methods]
        cells = [f"{each.percents} ({100 * each.found:.0f})" for each in summaries]
        rows.append([name, *cells, _bias_and_coverage(summaries[methods.index(OURS)])])
    return table(["size", *methods, "ours: bias px, 95 % interval holds %"], rows)


def _bias_and_coverage(summary) -> str:
    return "–" if not summary.found else f"{summary.bias_px:+.2f}, {100 * summary.coverage:.0f}"


def _facts(samples: list[Sample]) -> dict[str, float]:
    mine = [sample for sample in samples if sample.method == OURS]
    facts = {"tag coverage": summarise(mine, GROSS).coverage}
    for name, of_row in grouped(mine, lambda sample: sample.row).items():
        summary = summarise(of_row, GROSS)
        facts[f"tag {name}"] = summary.median
    # The troubles' rows start with the size, as in "48 px noise 8".
    for trouble, of_trouble in grouped(mine, lambda sample: sample.row.partition(" px ")[2] or "clean").items():
        facts[f"tag {trouble} coverage"] = summarise(of_trouble, GROSS).coverage
    return facts
