"""How well posters of known size are measured, by their size in the frame and their tilt."""

from __future__ import annotations

import math

import ours
from by_row import facts_by_row, table_by_row
from part import Part
from samples import Sample, ours_of
from workload import over_seeds

from support.detector_rigs import poster_file
from support.scenes import draw
from support.scenes.poster import poster_scene
from support.scenes.render import render

SIZES_PX = (60, 120, 300)
MAX_TILT_DEG = 50
SEEDS_OF_TILT = 7
"""Tilts are spread evenly over so many seeds."""


def run(frames: int, workers: int, first_seed: int = draw.REPORT_SEEDS.start) -> Part:
    """Measure so many posters at each size, and look for each poster in the scene of another one."""
    samples = over_seeds(samples_of, range(first_seed, first_seed + frames), workers)
    text = (
        f"{frames} posters of 40 x 30 cm in each row, turned any way, tilted by 0 to {MAX_TILT_DEG}°, on clutter. "
        "A row's size is the longer side as if it were not tilted. In the last row the detector looks for another "
        "poster than the one that is there.\n\n"
    )
    return Part(title="Picture", text=text + table_by_row("size", samples), facts=facts_by_row("picture", samples))


def samples_of(seed: int) -> list[Sample]:
    """Measure one poster at every size, and look for another one."""
    tilt_rad = math.radians(MAX_TILT_DEG * (seed % SEEDS_OF_TILT) / (SEEDS_OF_TILT - 1))
    found = []
    for size_px in SIZES_PX:
        scene = poster_scene(seed, size_px, tilt_rad)
        made = render(scene)
        finder = ours.detector("picture", scene.camera, file=str(poster_file(seed)), width="40 cm", min_side_px=24)
        found.append(ours_of(f"{size_px} px", seed, made.truth, ours.measure(finder, made)))
    other = ours.detector("picture", scene.camera, file=str(poster_file(seed + 1)), width="40 cm", min_side_px=24)
    found.append(ours_of("another poster", seed, made.truth, ours.measure(other, made)))
    return found
