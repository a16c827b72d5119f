"""How well the distance of a sheet or a disc is measured: by tilt, before a plain wall and before clutter."""

from __future__ import annotations

import math
from functools import cache

import ours
import tutorial
from msgspec.structs import replace
from part import Part, table
from samples import OURS, TUTORIAL, Sample, grouped, ours_of, summarise
from workload import over_seeds

from stadimeter.ranging.similar_triangles import distance_m
from support.scenes import draw
from support.scenes.nuisances import CAMERA_NUISANCES, SHEET_NUISANCES
from support.scenes.plane import Pose
from support.scenes.render import render
from support.scenes.scene import RenderedScene, Scene, Truth

GROSS = 0.05
TILTS_DEG = (0, 15, 30, 45, 60)
TROUBLED_TILT_DEG = 30
CALIBRATION_M = 1.0
CAMERAS_EVERY = 3
"""Of so many sheets, one is seen through other cameras too."""

OTHER_CAMERA = "other camera: "
ELSEWHERE = "stadimeter, of something else"


def run_sheet(frames: int, workers: int, first_seed: int = draw.REPORT_SEEDS.start) -> Part:
    """Measure so many sheets at each tilt, before both backdrops, and under each trouble."""
    samples = over_seeds(sheet_samples_of, range(first_seed, first_seed + frames), workers)
    text = (
        f"{frames} sheets of A4 in each row, 0.6–4 m away, rolled by up to 34°. The tutorial's longer side is taken, "
        "and only where its box is about the sheet; elsewhere it counts as missed. Gross is an error above 5 %.\n\n"
        + _table([sample for sample in samples if not sample.row.startswith(OTHER_CAMERA)])
    )
    assumed = [sample for sample in samples if not sample.row.startswith(OTHER_CAMERA)]
    text += f"\nCameras that differ from what is assumed of them; plain, {TROUBLED_TILT_DEG}°:\n\n"
    text += _table([sample for sample in samples if sample.row.startswith(OTHER_CAMERA)])
    return Part(title="Sheet", text=text, facts=_facts("sheet", assumed))


def run_disc(frames: int, workers: int, first_seed: int = draw.REPORT_SEEDS.start) -> Part:
    """Measure so many discs at each tilt, before both backdrops."""
    every = over_seeds(disc_samples_of, range(first_seed, first_seed + frames), workers)
    samples = [sample for sample in every if sample.method == OURS]
    gross = [sample for sample in samples if abs(sample.error) > GROSS]
    elsewhere = [sample for sample in every if sample.method == ELSEWHERE and abs(sample.error) > GROSS]
    text = (
        f"{frames} white discs of 12 cm in each row, 0.3–3 m away. Tilts are from the optical axis: at 60° some discs "
        "in the corners are seen on edge. Gross is an error above 5 %: of these "
        f"{len(gross)}, {len(elsewhere)} are measurements of something else than the disc, mostly whole ellipses of "
        "the clutter, which nothing tells from discs. The 95 % interval is that of measurements of the disc.\n\n"
    )
    return Part(title="Disc", text=text + _table(samples), facts=_facts("disc", samples))


def sheet_samples_of(seed: int) -> list[Sample]:
    """Measure one sheet in every row."""
    found = []
    for name, scene in _sheet_scenes(seed).items():
        made = render(scene)
        measured = ours.measure(ours.detector("sheet", scene.camera), made)
        found += [ours_of(name, seed, made.truth, measured), _tutorial(name, seed, made)]
    return found


def disc_samples_of(seed: int) -> list[Sample]:
    """Measure one disc in every row."""
    found = []
    for name, scene in _disc_scenes(seed).items():
        made = render(scene)
        measured = ours.measure(ours.detector("disc", scene.camera), made)
        sample = ours_of(name, seed, made.truth, measured)
        if measured.position_m is not None and not _is_on_disc(measured.position_m, made.truth):
            sample = replace(sample, sigma_m=None)
            found.append(replace(sample, method=ELSEWHERE))
        found.append(sample)
    return found


def _disc_scenes(seed: int) -> dict[str, Scene]:
    scenes = {}
    for plain in (True, False):
        for tilt in TILTS_DEG:
            before = "plain" if plain else "clutter"
            scenes[f"{before} {tilt}°"] = draw.disc_scene(seed, math.radians(tilt), plain=plain)
    still = draw.disc_scene(seed, math.radians(TROUBLED_TILT_DEG), plain=True)
    for name, nuisance in SHEET_NUISANCES.items():
        if name != "clean":
            scenes[f"plain {TROUBLED_TILT_DEG}° {name}"] = nuisance(still)
    return scenes


def _is_on_disc(position_m: tuple[float, float, float], truth: Truth) -> bool:
    """Return whether the line of sight to a place meets the disc, or passes near it."""
    x, y, z = position_m
    true_x, true_y, true_z = truth.position_m
    return math.dist((x / z, y / z), (true_x / true_z, true_y / true_z)) < draw.DISC_M / 2 / true_z


def _sheet_scenes(seed: int) -> dict[str, Scene]:
    scenes = {}
    for plain in (True, False):
        before = "plain" if plain else "clutter"
        for tilt in TILTS_DEG:
            scenes[f"{before} {tilt}°"] = draw.sheet_scene(seed, math.radians(tilt), plain=plain)
    still = {plain: draw.sheet_scene(seed, math.radians(TROUBLED_TILT_DEG), plain=plain) for plain in (True, False)}
    for name, nuisance in SHEET_NUISANCES.items():
        if name != "clean":
            scenes[f"plain {TROUBLED_TILT_DEG}° {name}"] = nuisance(still[True])
    scenes[f"clutter {TROUBLED_TILT_DEG}° jpeg 80"] = SHEET_NUISANCES["jpeg 80"](still[False])
    if seed % CAMERAS_EVERY == 0:
        scenes |= {f"{OTHER_CAMERA}{name}": nuisance(still[True]) for name, nuisance in CAMERA_NUISANCES.items()}
    return scenes


def _tutorial(row: str, seed: int, made: RenderedScene) -> Sample:
    truth = made.truth
    measured = None
    if tutorial.is_the_sheet(made.image, truth.outline_px):
        measured = distance_m(tutorial_focal_px(), max(draw.SHEET_M), tutorial.sheet_long_side_px(made.image))
    return Sample(
        row=row, method=TUTORIAL, seed=seed, apparent_px=truth.apparent_px, true_m=truth.depth_m, measured_m=measured
    )


@cache
def tutorial_focal_px() -> float:
    """Calibrate as the tutorial does: from one picture of the sheet, 1 m away in the middle, before a plain wall."""
    scene = draw.sheet_scene(draw.TUNING_SEEDS.start, 0.0, plain=True)
    facing = replace(scene, target=replace(scene.target, pose=Pose(position_m=(0.0, 0.0, CALIBRATION_M))))
    return tutorial.sheet_long_side_px(render(facing).image) * CALIBRATION_M / max(draw.SHEET_M)


def _table(samples: list[Sample]) -> str:
    has_tutorial = any(sample.method == TUTORIAL for sample in samples)
    rows = []
    for name, of_row in grouped(samples, lambda sample: sample.row).items():
        we = summarise([sample for sample in of_row if sample.method == OURS], GROSS)
        cells = [name, we.percents, we.failures, f"{we.bias_px:+.2f}", f"{100 * we.coverage:.0f}"]
        if has_tutorial:
            they = summarise([sample for sample in of_row if sample.method == TUTORIAL], GROSS)
            cells += [they.percents, they.failures]
        rows.append(cells)
    head = ["scene", "ours: median / p95 %", "gross / missed %", "bias px", "95 % interval holds %"]
    return table(head + ["tutorial: median / p95 %", "gross / missed %"] * has_tutorial, rows)


def _facts(what: str, samples: list[Sample]) -> dict[str, float]:
    mine = [sample for sample in samples if sample.method == OURS]
    tilts = {f"{before} {tilt}°": before for before in ("plain", "clutter") for tilt in TILTS_DEG}
    by_backdrop = grouped([s for s in mine if s.row in tilts], lambda sample: tilts[sample.row])
    facts = {f"{what} coverage": summarise(mine, GROSS).coverage}
    for before, of_backdrop in by_backdrop.items():
        summary = summarise(of_backdrop, GROSS)
        facts |= {f"{what} {before} {key}": getattr(summary, key) for key in ("median", "p95", "found", "gross")}
    for name, of_row in grouped(mine, lambda sample: tilts.get(sample.row, sample.row)).items():
        facts[f"{what} {name} coverage"] = summarise(of_row, GROSS).coverage
    return facts
