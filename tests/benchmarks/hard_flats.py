"""How well flat things are measured as they are met outside, and what is seen in rooms without any of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import ours
from msgspec import Struct
from msgspec.structs import replace
from part import Part, table
from samples import Sample, Summary, ours_of, rate, summarise
from workload import over_seeds

from stadimeter.core.camera_model import UNKNOWN_EDGE_BIAS_SIGMA_PX
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.ranging.measure import measure
from support.scenes import draw, hard_flats
from support.scenes.cut_sheet import GroupTarget
from support.scenes.hard_flats import BACKDROPS, CLUTTER, ROOM, HardFlat
from support.scenes.render import render
from support.scenes.scene import RenderedScene, Scene

GROSS = 0.1
MM = 0.001
ROOMS_A_SEED = 3
LARGE_PX = (60.0, 300.0)
APART = 100_000
"""Scenes before other backdrops are other scenes: their seeds lie so far apart."""

SIGMAS_OF_A_CUT = 0.7
"""Standard deviation of a side, as a share of the most by which its two ends are off."""

CARD, TAPE = "card ±1 mm", "tape ±1 mm"
OF_EACH_BACKDROP = (CARD, TAPE)
"""What is measured so often before each backdrop that each has a row."""

CUT, DISC = "cut", "disc"

ROOM_FINDERS = {
    "sheet": ("sheet", {}),
    "sheet, one side known": ("sheet", {"known_side": "width"}),
    "card ±1 mm, from 8 px": (
        "sheet",
        {"width": "0.1 m", "height": "0.075 m", "min_side_px": 8.0, "tolerance": "0.7 mm"},
    ),
    "disc": ("disc", {}),
    "ball": ("ball", {}),
    "ball, magenta": ("ball", {"hsv": "140,100,50:170,255,255"}),
    "tag": ("tag", {}),
}
"""What is looked for in rooms: a name, the target and how its options differ."""


class FlatSample(Struct, frozen=True, kw_only=True):
    """One measurement of one scene.

    Attributes:
        table: Which table it belongs to.
        kinds: The rows that it counts in, one of each group.
        sample: The measurement.
        is_said: Whether it was said to be ambiguous, or perhaps the target.
        is_elsewhere: Whether something else than the target was measured.
    """

    table: str
    kinds: tuple[str, ...]
    sample: Sample
    is_said: bool = False
    is_elsewhere: bool = False


class RoomLook(Struct, frozen=True, kw_only=True):
    """What one look into one empty room found."""

    what: str
    status: DetectionStatus


TABLES = {
    CUT: (
        f"What is measured with has the true focal length, and an edge bias of 0 ± {UNKNOWN_EDGE_BIAS_SIGMA_PX} px, as "
        "`calibrate` writes it where nothing tells more. "
        "Cards meant to be 100 × 75 mm and strips of tape meant to be 127 × 51 mm, 15–60 px long and 8 px high at "
        "least, tilted by up to 45°, taken by cameras of random quality. ±1 mm: each place of a side (of tape: of an "
        "end) is off by up to 1 mm, evenly spread, 0.58 mm rms, smoothly along it. Large: A4, 60–300 px. Of two strips "
        "beside each other, either is right, and so is to "
        "say that it is ambiguous. A scene counts in a row of each group. Where its colour is "
        "given, that is a range around it. The 95 % interval is that of measurements of the target."
    ),
    DISC: "Discs of 12 cm, 20–240 px, tilted by up to 60°. Wrong is what lies outside of the disc in the picture.",
}


def run(frames: int, workers: int, first_seed: int = draw.REPORT_SEEDS.start) -> Part:
    """Measure so many scenes in each cell, and look into three times as many empty rooms."""
    seeds = range(first_seed, first_seed + frames)
    found = over_seeds(samples_of, seeds, workers)
    looks = over_seeds(looks_of, seeds, workers)
    text, facts = "", _room_facts(looks)
    for name, said in TABLES.items():
        samples = [each for each in found if each.table == name]
        text += f"{said}\n\n{_rows(samples)}\n"
        facts |= _facts(name, samples)
    count = ROOMS_A_SEED * frames
    text += (
        f"{count} rooms and floors without any target: cupboards, shelves, tiles, windows, chairs, cubes of cloth, "
        "boxes. No rectangle in them has an aspect from 1.22 to 1.62; nothing is a disc or a ball. Cut off: said to "
        f"be cut off by the border.\n\n{_room_rows(looks)}\n"
    )
    return Part(title="Flat things as they are met", text=text, facts=facts)


def samples_of(seed: int) -> list[FlatSample]:
    """Measure what belongs to one seed: one scene for each cell."""
    return [*_cut(seed), *_discs(seed)]


def looks_of(seed: int) -> list[RoomLook]:
    """Look for everything in some rooms without it."""
    looks = []
    for number in range(ROOMS_A_SEED):
        image = render(hard_flats.hard_empty(ROOMS_A_SEED * seed + number)).image
        for name, (target, options) in ROOM_FINDERS.items():
            finder = ours.detector(target, draw.CAMERA, **options)
            looks.append(RoomLook(what=name, status=finder.detect(ours.framed(image)).status))
    return looks


def _cut(seed: int) -> Iterable[FlatSample]:
    turn = BACKDROPS[seed % len(BACKDROPS)]
    for number, backdrop in enumerate(BACKDROPS):
        own = seed + number * APART
        yield _flat(CUT, CARD, hard_flats.hard_sheet(own, MM, backdrop=backdrop))
        yield _flat(CUT, TAPE, hard_flats.hard_tape(own, MM, backdrop=backdrop, pairs=0.0))
    for kind, flat in (
        (CARD, hard_flats.hard_sheet(seed, MM, backdrop=turn)),
        (TAPE, hard_flats.hard_tape(seed, MM, backdrop=turn, pairs=0.0)),
    ):
        yield _flat(CUT, f"{kind}, its colour given", flat, colour=flat.hsv)
    yield _flat(CUT, "card ±0", hard_flats.hard_sheet(seed, 0.0, backdrop=turn))
    yield _flat(CUT, "card ±2 mm", hard_flats.hard_sheet(seed, 2 * MM, backdrop=turn))
    yield _flat(CUT, "tape ±2 mm", hard_flats.hard_tape(seed, 2 * MM, backdrop=turn, pairs=0.0))
    yield _flat(CUT, "tape ±1 mm with a twin", hard_flats.hard_tape(seed, MM, backdrop=turn, pairs=1.0))
    large = hard_flats.hard_sheet(seed, MM, LARGE_PX, backdrop=turn, side_m=draw.SHEET_M)
    yield _flat(CUT, "large ±1 mm", large)


def _discs(seed: int) -> Iterable[FlatSample]:
    for backdrop in (CLUTTER, ROOM):
        flat = hard_flats.hard_disc(seed, backdrop=backdrop)
        yield _measured(DISC, ("all", f"before {backdrop}"), flat.scene, "disc")


def _flat(name: str, kind: str, flat: HardFlat, colour: str | None = None) -> FlatSample:
    """Measure a sheet or a strip with what a user would say of it."""
    options = {
        "width": f"{flat.width_m} m",
        "height": f"{flat.height_m} m",
        "hsv": colour,
        "min_side_px": hard_flats.LEAST_SIDE_PX,
        "tolerance": f"{flat.cut_m * SIGMAS_OF_A_CUT} m" if flat.cut_m > 0 else None,
    }
    kinds = ("all", kind)
    if kind in OF_EACH_BACKDROP:
        kinds += (f"{kind} before {flat.backdrop}",)
    return _measured(name, kinds, flat.scene, "sheet", **options)


def _measured(name: str, kinds: tuple[str, ...], scene: Scene, target: str, **options: object) -> FlatSample:
    made = render(scene)
    camera = replace(draw.CAMERA, edge_bias_sigma_px=UNKNOWN_EDGE_BIAS_SIGMA_PX)
    finder = ours.detector(target, camera, **options)
    found = finder.detect(ours.framed(made))
    measured = measure(found, finder.target_shape, found.measured_with or camera, 0.0)
    sample = ours_of(kinds[-1], scene.seed, made.truth, measured)
    sample, is_elsewhere = _of_nearest(sample, found, scene, made)
    if is_elsewhere:
        # How well the interval of another thing holds says nothing; that it was taken has a column of its own.
        sample = replace(sample, sigma_m=None)
    is_said = "ambiguous" in found.reason or found.status is DetectionStatus.PERHAPS
    return FlatSample(table=name, kinds=kinds, sample=sample, is_said=is_said, is_elsewhere=is_elsewhere)


def _of_nearest(sample: Sample, found: Detection, scene: Scene, made: RenderedScene) -> tuple[Sample, bool]:
    """Compare with the twin that was measured, and say whether it was neither of them."""
    if not found.is_whole:
        return sample, False
    outlines = {made.truth.distance_m: made.truth.outline_px}
    if isinstance(scene.target, GroupTarget):
        for other in scene.target.others:
            points = other.outline_m()
            outlines[math.hypot(*other.position_m)] = scene.camera.project(points[:, :2] / points[:, 2:])
    centres = {true_m: outline.mean(axis=0) for true_m, outline in outlines.items()}
    true_m = min(centres, key=lambda each: math.dist(centres[each], found.centre_px))
    reach = max(math.dist(centres[true_m], corner) for corner in outlines[true_m])
    return replace(sample, true_m=true_m), math.dist(centres[true_m], found.centre_px) > reach / 2


def _by_kind(samples: Sequence[FlatSample]) -> dict[str, list[FlatSample]]:
    """Return the samples of each kind, in the order in which groups and kinds are told."""
    groups: dict[str, list[FlatSample]] = {}
    for place in range(3):
        for each in samples:
            for kind in each.kinds[place : place + 1]:
                groups.setdefault(kind, []).append(each)
    return groups


def _summary(samples: Sequence[FlatSample]) -> Summary:
    return summarise([each.sample for each in samples], GROSS)


def _unsaid(samples: Sequence[FlatSample]) -> float:
    """Return the share in which another thing was measured and nobody was told."""
    return sum(each.is_elsewhere and not each.is_said for each in samples) / len(samples) if samples else math.nan


def _rows(samples: Sequence[FlatSample]) -> str:
    head = (
        "kind",
        "frames",
        "median / p95 %",
        "found %",
        f"off by more than {GROSS:.0%}, %",
        "another thing, unsaid, %",
        "said to be ambiguous or perhaps %",
        "95 % interval holds %",
    )
    rows = []
    for kind, of_kind in _by_kind(samples).items():
        each = _summary(of_kind)
        shares = (each.found, each.gross, _unsaid(of_kind), sum(one.is_said for one in of_kind) / each.count)
        rates = (rate(share, each.count) for share in shares)
        held = rate(each.coverage, sum(one.sample.sigma_m is not None for one in of_kind))
        rows.append((kind, str(each.count), each.percents, *rates, held))
    return table(head, rows)


def _facts(name: str, samples: Sequence[FlatSample]) -> dict[str, float]:
    facts = {}
    kinds = {kind: _summary(of_kind) for kind, of_kind in _by_kind(samples).items()}
    for kind, each in kinds.items():
        facts |= {f"hard flat {name} {kind} {what}": getattr(each, what) for what in ("median", "found", "gross")}
        facts[f"hard flat {name} {kind} held"] = each.coverage
    held = [each.coverage for each in kinds.values() if not math.isnan(each.coverage)]
    facts[f"hard flat {name} held least"] = min(held, default=math.nan)
    facts[f"hard flat {name} held most"] = max(held, default=math.nan)
    facts[f"hard flat {name} elsewhere"] = _unsaid(samples)
    return facts


def _room_rows(looks: Sequence[RoomLook]) -> str:
    rows = []
    for name in ROOM_FINDERS:
        statuses = [look.status for look in looks if look.what == name]
        shares = [statuses.count(each) / len(statuses) for each in (DetectionStatus.FOUND, DetectionStatus.TRUNCATED)]
        rows.append((name, str(len(statuses)), *(rate(share, len(statuses)) for share in shares)))
    return table(("looked for", "rooms", "found %", "cut off %"), rows)


def _room_facts(looks: Sequence[RoomLook]) -> dict[str, float]:
    facts = {}
    for name in ROOM_FINDERS:
        statuses = [look.status for look in looks if look.what == name]
        facts[f"hard rooms {name}"] = statuses.count(DetectionStatus.FOUND) / len(statuses)
        facts[f"hard rooms {name} cut off"] = statuses.count(DetectionStatus.TRUNCATED) / len(statuses)
    return facts
