"""How well the distance of a ball is measured, under each trouble and at each size."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import ours
import tutorial
from msgspec.structs import replace
from part import Chart, Part, table
from samples import OURS, TUTORIAL, Sample, Summary, grouped, ours_of, summarise
from workload import over_seeds

from stadimeter.ranging.similar_triangles import distance_m
from support.scenes import draw
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.nuisances import BALL_NUISANCES, HARDER_NUISANCES
from support.scenes.render import render
from support.scenes.scene import RenderedScene, Scene

GROSS = 0.3
LARGE_RADIUS_PX = 20.0
RADII_PX = (3, 5, 10, 20, 40, 80, 140)
CALIBRATION_M = 1.0
HARDER_EVERY = 3
"""Of so many scenes, one is measured under the harder troubles too."""

KNOWN_TO_CAMERA = "barrel lens, known"
"""The one trouble that the tutorial has no way to be told of."""


def run(frames: int, workers: int, first_seed: int = draw.REPORT_SEEDS.start) -> Part:
    """Measure so many balls under each trouble.

    Args:
        frames: How many scenes.
        workers: How many processes.
        first_seed: The first of them.

    Returns:
        The part of the report.
    """
    samples = over_seeds(samples_of, range(first_seed, first_seed + frames), workers)
    main = [sample for sample in samples if sample.row in BALL_NUISANCES]
    harder = [sample for sample in samples if sample.row in HARDER_NUISANCES]
    text = (
        _introduction(frames)
        + _nuisance_table(main)
        + "\nBalls of a radius above 20 px only:\n\n"
        + _nuisance_table(_large(main))
        + "\nClean frames by radius:\n\n"
        + _radius_table([sample for sample in main if sample.row == "clean"])
        + "\nWhere assumptions end; radius above 20 px:\n\n"
        + _nuisance_table(_large(harder))
    )
    return Part(title="Ball", text=text, charts=[_chart(main)], facts=_facts(main))


def samples_of(seed: int) -> list[Sample]:
    """Measure one scene under every trouble."""
    scene = draw.ball_scene(seed)
    # Kinds of balls alternate with the seed, so pairs of seeds are taken or left.
    is_harder_too = seed // 2 % HARDER_EVERY == 0
    found = []
    for name, nuisance in (BALL_NUISANCES | HARDER_NUISANCES if is_harder_too else BALL_NUISANCES).items():
        troubled = nuisance(scene)
        made = render(troubled)
        found.append(_ours(name, troubled, made))
        if name != KNOWN_TO_CAMERA:
            found.append(_tutorial(name, troubled, made))
    return found


def _ours(row: str, scene: Scene, made: RenderedScene) -> Sample:
    finder = ours.detector(_target(scene), scene.camera)
    return ours_of(row, scene.seed, made.truth, ours.measure(finder, made))


def _target(scene: Scene) -> str:
    return "ball" if scene.target.diameter_m == draw.TENNIS_M else "large ball"


def _tutorial(row: str, scene: Scene, made: RenderedScene) -> Sample:
    """Measure as the tutorial does. It knows depth only, so that is what it is held to."""
    radius = tutorial.ball_radius_px(made.image)
    diameter = scene.target.diameter_m
    measured = None if not radius else distance_m(tutorial_focal_px(diameter), diameter, 2 * radius)
    truth = made.truth
    return Sample(
        row=row,
        method=TUTORIAL,
        seed=scene.seed,
        apparent_px=truth.apparent_px,
        true_m=truth.depth_m,
        measured_m=measured,
    )


@cache
def tutorial_focal_px(diameter_m: float) -> float:
    """Calibrate as the tutorial does: from one picture of the ball, 1 m away in the middle, before a plain wall."""
    ball = BallTarget(position_m=(0.0, 0.0, CALIBRATION_M), diameter_m=diameter_m)
    made = render(replace(draw.empty_scene(draw.TUNING_SEEDS.start), target=ball, backdrop=PlainBackdrop()))
    return 2 * tutorial.ball_radius_px(made.image) * CALIBRATION_M / diameter_m


def _large(samples: list[Sample]) -> list[Sample]:
    return [sample for sample in samples if sample.apparent_px / 2 > LARGE_RADIUS_PX]


def _introduction(frames: int) -> str:
    return (
        f"{frames} scenes, each under every trouble: a 6.7 cm ball 0.3–4 m away or a 20 cm ball 0.45–6 m away, "
        "anywhere in 640×480 px, f = 600 px. Ours is held to the straight line to the centre, with the true focal "
        "length; the tutorial to the depth, with its own calibration from one picture at 1 m. "
        "Errors are of all frames with an "
        "answer; gross is an error above 30 %, missed is no answer, both of all frames.\n\n"
    )


def _nuisance_table(samples: list[Sample]) -> str:
    head = (
        "trouble",
        "frames",
        "ours: median / p95 %",
        "gross / missed %",
        "bias px",
        "95 % interval holds %",
        "tutorial: median / p95 %",
        "gross / missed %",
        "bias px",
    )
    rows = []
    for name, of_row in grouped(samples, lambda sample: sample.row).items():
        by_method = {method: _summary(of_row, method) for method in (OURS, TUTORIAL)}
        we, they = by_method[OURS], by_method[TUTORIAL]
        rows.append(
            (
                name,
                str(we.count),
                we.percents,
                we.failures,
                f"{we.bias_px:+.2f}",
                f"{100 * we.coverage:.0f}",
                they.percents,
                they.failures if they.count else "–",
                f"{they.bias_px:+.2f}" if they.count else "–",
            )
        )
    return table(head, rows)


def _summary(samples: list[Sample], method: str) -> Summary:
    return summarise([sample for sample in samples if sample.method == method], GROSS)


def _radius_table(samples: list[Sample]) -> str:
    rows = []
    for low, high in pairwise(RADII_PX):
        inside = _of_radius(samples, low, high)
        if inside:
            we, they = _summary(inside, OURS), _summary(inside, TUTORIAL)
            cells = (str(we.count), we.percents, we.failures, f"{we.bias_px:+.2f}", they.percents, they.failures)
            rows.append((f"{low}–{high} px", *cells))
    head = ("radius", "frames", "ours: median / p95 %", "gross / missed %", "bias px")
    return table((*head, "tutorial: median / p95 %", "gross / missed %"), rows)


def _of_radius(samples: list[Sample], low: float, high: float) -> list[Sample]:
    return [sample for sample in samples if low <= sample.apparent_px / 2 < high]


def _facts(samples: list[Sample]) -> dict[str, float]:
    by_row = grouped([sample for sample in samples if sample.method == OURS], lambda sample: sample.row)
    facts = {"ball coverage": summarise([s for row in by_row.values() for s in row], GROSS).coverage}
    for name, of_row in by_row.items():
        whole, large = summarise(of_row, GROSS), summarise(_large(of_row), GROSS)
        facts |= {f"ball {name} large": large.median, f"ball {name} coverage": whole.coverage}
        facts[f"ball {name} found"] = whole.found - whole.gross
    facts["ball small"] = summarise(_of_radius(by_row["clean"], 5, 10), GROSS).median
    return facts


def _chart(samples: list[Sample]) -> Chart:
    groups = grouped(samples, lambda sample: sample.row)
    series = {
        f"{method}, {what}": [100 * getattr(_summary(group, method), what) for group in groups.values()]
        for method in (OURS, TUTORIAL)
        for what in ("median", "p95")
    }
    return Chart(
        name="ball-error", title="Ball: error by trouble", axis="relative error, %", rows=list(groups), series=series
    )
