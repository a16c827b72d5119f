"""How well targets are measured under water, by a camera that was calibrated in air, behind a flat window."""

from __future__ import annotations

import numpy as np
import ours
from by_row import facts_by_row, table_by_row
from msgspec.structs import replace
from part import Part
from samples import Sample, ours_of
from workload import over_seeds

from stadimeter.core.camera_model import behind_flat_port
from support.scenes import draw
from support.scenes.render import render
from support.scenes.water import CAMERA, INDEX

TAG_PX = (40.0, 150.0)
MAX_TILT_RAD = 0.7


TOLD = behind_flat_port(draw.CAMERA, "water", 0.0)
"""What the detectors are told of it."""


def run(frames: int, workers: int, first_seed: int = draw.REPORT_SEEDS.start) -> Part:
    """Measure so many balls, sheets and tags."""
    samples = over_seeds(samples_of, range(first_seed, first_seed + frames), workers)
    text = (
        "Scenes as in the tables of balls, sheets and tags, on clutter, with rays turned at a flat window "
        f'(n = {INDEX}): the camera is described as in air, with `medium = "water"`.\n\n'
    )
    table = table_by_row("target", samples)
    return Part(title="Under water", text=text + table, facts=facts_by_row("water", samples))


def samples_of(seed: int) -> list[Sample]:
    """Measure one target of each kind."""
    rng = np.random.default_rng((seed, 90))
    tilt_rad = float(rng.uniform(0, MAX_TILT_RAD))
    scenes = {
        "ball": draw.ball_scene(2 * seed, CAMERA),
        "sheet": draw.sheet_scene(seed, tilt_rad, plain=True, camera=CAMERA),
        "tag": draw.tag_scene(seed, float(rng.uniform(*TAG_PX)), tilt_rad, CAMERA),
    }
    found = []
    for name, scene in scenes.items():
        made = render(scene)
        options = {"id": scene.target.number} if name == "tag" else {}
        finder = ours.detector(name, replace(TOLD, focal_relative_sigma=0.0), **options)
        found.append(ours_of(name, seed, made.truth, ours.measure(finder, made)))
    return found
