"""How well three equal circles on paper are measured, by how far apart they appear."""

from __future__ import annotations

import math

import ours
from by_row import facts_by_row, table_by_row
from part import Part
from samples import Sample, ours_of
from workload import over_seeds

from support.scenes import draw
from support.scenes.circles import circles_scene
from support.scenes.render import render

SIZES_PX = (60, 100, 200)
MAX_TILT_DEG = 50
SEEDS_OF_TILT = 7
"""Tilts are spread evenly over so many seeds."""


def run(frames: int, workers: int, first_seed: int = draw.REPORT_SEEDS.start) -> Part:
    """Measure so many triangles of circles at each size, and look for those of another spacing."""
    samples = over_seeds(samples_of, range(first_seed, first_seed + frames), workers)
    text = (
        f"{frames} triangles of black circles on white paper in each row, 5 cm wide and 10 cm apart, turned any way, "
        f"tilted by 0 to {MAX_TILT_DEG}°, on clutter. A row's size is a side of the triangle as if it were not tilted. "
        "In the last row the detector looks for circles 14 cm apart.\n\n"
    )
    table = table_by_row("side", samples)
    return Part(title="Three circles", text=text + table, facts=facts_by_row("circles", samples))


def samples_of(seed: int) -> list[Sample]:
    """Measure one triangle in every row."""
    tilt_rad = math.radians(MAX_TILT_DEG * (seed % SEEDS_OF_TILT) / (SEEDS_OF_TILT - 1))
    pictures = {size_px: render(circles_scene(seed, size_px, tilt_rad)) for size_px in SIZES_PX}
    asked = {f"{size_px} px": (made, "10 cm") for size_px, made in pictures.items()}
    asked["14 cm apart"] = (pictures[SIZES_PX[0]], "14 cm")
    found = []
    for name, (made, spacing) in asked.items():
        finder = ours.detector("circles", draw.CAMERA, diameter="5 cm", spacing=spacing)
        found.append(ours_of(name, seed, made.truth, ours.measure(finder, made)))
    return found
