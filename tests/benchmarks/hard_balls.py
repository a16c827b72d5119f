"""How well a ball is measured as it is met outside: marked, on floors, in hands; and small ones that move."""

from __future__ import annotations

from collections.abc import Iterable

import ours
from msgspec import Struct
from msgspec.structs import replace
from part import Part, table
from samples import Sample, Summary, ours_of, rate, summarise
from workload import over_seeds

from support.scenes import draw, nuisances
from support.scenes.backdrop import ClutterBackdrop, PlainBackdrop
from support.scenes.hard_balls import BACKDROPS, HardBall, hard_ball, silver_ball
from support.scenes.render import render
from support.scenes.scene import RenderedScene, Scene

GROSS = 0.1
LARGE_PX, SMALL_PX, BLURRED_PX, SILVER_PX = (20.0, 70.0), (5.0, 10.0), (5.0, 14.0), (10.0, 70.0)
SILVER_EVERY = 4
"""Of so many seeds, one is taken for silver balls."""

BLURRED_EVERY = 8
"""Of so many seeds, one is taken for small and blurred balls."""

WALL = PlainBackdrop(bgr=(150, 155, 160))


class HardSample(Struct, frozen=True, kw_only=True):
    """One measurement of one scene, with the table and the rows that it belongs to."""

    table: str
    kinds: tuple[str, ...]
    sample: Sample


def run(frames: int, workers: int, first_seed: int = draw.REPORT_SEEDS.start) -> Part:
    """Measure so many hard balls, and a share of them for the other tables."""
    found = over_seeds(samples_of, range(first_seed, first_seed + frames), workers)
    tables = {name: [each for each in found if each.table == name] for name in TABLES}
    text = "".join(f"{TABLES[name]}\n\n{_rows(samples)}\n" for name, samples in tables.items() if samples)
    return Part(title="Balls as they are met", text=text, facts=_facts(tables))


TABLES = {
    "large": (
        "Balls of a radius from 20 to 70 px, smooth or felt, with stripes, seams, patches or a logo, some dirty, on "
        "five kinds of floor with their shadow, before walls and clutter, some held by fingers; cameras with four tone "
        "curves, sharpening, shot noise, and colour halved in two of three. The detector is given the range of colours "
        "around the ball's own, without its pale parts. A scene counts in a row of each group."
    ),
    "small": "The same with a radius from 5 to 10 px.",
    "silver": (
        "A shiny ball of the colour of the wall, or grey before floors and clutter, that mirrors what is above and "
        "below, 10 to 70 px in radius. The detector is given no colours."
    ),
    "blurred": "A plain ball of 5 to 14 px in radius with motion of 6 px, looked for where it is expected.",
}


def samples_of(seed: int) -> list[HardSample]:
    """Measure what belongs to one seed."""
    # Each backdrop comes equally often.
    hard = hard_ball(seed, LARGE_PX, backdrop=BACKDROPS[seed % len(BACKDROPS)])
    found = [_hard("large", hard)]
    number = seed // len(BACKDROPS)
    if number % 2 == 0:
        found.append(_hard("small", hard_ball(seed + 500_000, SMALL_PX)))
    if seed % BLURRED_EVERY == 2:
        found += list(_blurred(seed))
    if seed % SILVER_EVERY == 3:
        found.append(_silver(seed))
    return found


def _silver(seed: int) -> HardSample:
    drawn = silver_ball(seed, SILVER_PX)
    kinds = ("all", f"on {drawn.backdrop}")
    return _measured("silver", kinds, drawn.scene, render(drawn.scene), None)


def _hard(name: str, hard: HardBall) -> HardSample:
    held = "held by fingers" if hard.has_hand else "free"
    marking, _, felt = hard.surface.partition(", ")
    kinds = ("all", f"on {hard.backdrop}", f"with {marking}", felt or "smooth", held, str(hard.scene.sensor.tone))
    return _measured(name, kinds, hard.scene, render(hard.scene), hard.hsv)


def _plain(seed: int, radii_px: tuple[float, float]) -> tuple[Scene, str]:
    """Return a scene with a smooth ball of one colour on a wall, with the sensor of the old tables."""
    hard = hard_ball(seed, radii_px, backdrop="wall")
    old = draw.ball_scene(seed)
    ball = replace(hard.scene.target, surface=None, bgr=old.target.bgr, floor_bgr=None)
    return replace(old, target=ball, backdrop=WALL), ours.BALL_HSV


def _blurred(seed: int) -> Iterable[HardSample]:
    scene, hsv = _plain(seed, BLURRED_PX)
    for behind, backdrop in (("plain", WALL), ("clutter", ClutterBackdrop())):
        moved = nuisances.motion(6)(replace(scene, backdrop=backdrop))
        yield _measured("blurred", ("all", f"on {behind}"), moved, render(moved), hsv, is_expected=True)


def _measured(
    name: str, kinds: tuple[str, ...], scene: Scene, made: RenderedScene, hsv: str | None, *, is_expected: bool = False
) -> HardSample:
    finder = ours.detector("ball", scene.camera, hsv=hsv, diameter=f"{scene.target.diameter_m} m")
    prediction = ours.prediction_of(made.truth) if is_expected else None
    measured = ours.measure(finder, made, prediction)
    return HardSample(table=name, kinds=kinds, sample=ours_of(kinds[-1], scene.seed, made.truth, measured))


def _by_kind(samples: list[HardSample]) -> dict[str, Summary]:
    """Return a summary for each kind, in the order in which groups and kinds are told."""
    pairs = [(kind, each.sample) for place in range(6) for each in samples for kind in each.kinds[place : place + 1]]
    kinds = {kind: [sample for other, sample in pairs if other == kind] for kind, _ in pairs}
    return {kind: summarise(of_kind, GROSS) for kind, of_kind in kinds.items()}


def _rows(samples: list[HardSample]) -> str:
    head = (
        "kind",
        "frames",
        "median / p95 %",
        "found %",
        f"off by more than {GROSS:.0%}, %",
        "bias px",
        "95 % interval holds %",
    )
    rows = []
    for kind, each in _by_kind(samples).items():
        answered = round(each.found * each.count)
        cells = (rate(each.found, each.count), rate(each.gross, each.count), f"{each.bias_px:+.2f}")
        rows.append((kind, str(each.count), each.percents, *cells, rate(each.coverage, answered)))
    return table(head, rows)


def _facts(tables: dict[str, list[HardSample]]) -> dict[str, float]:
    facts = {}
    for name, samples in tables.items():
        each = _by_kind(samples)
        if not each:
            continue
        whole = each["all"]
        facts |= {f"hard ball {name} {what}": getattr(whole, what) for what in ("median", "p95", "found", "gross")}
        # The names of coverages say nothing but "coverage" where they are goals of their own.
        facts[f"hard ball {name} held"] = whole.coverage
        facts[f"hard ball {name} held least"] = min(kind.coverage for kind in each.values())
        facts[f"hard ball {name} held most"] = max(kind.coverage for kind in each.values())
    return facts
