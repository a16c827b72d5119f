"""How well targets are measured under water, by a camera that was calibrated in air, behind a flat window."""

from __future__ import annotations

import numpy as np
import ours
from by_row import facts_by_row, table_by_row
from msgspec.structs import replace
from part import Part
from samples import Sample, ours_of
from workload import over_seeds

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points
from stadimeter.core.refraction import REFRACTIONS, behind_flat_port
from support.scenes import draw
from support.scenes.render import render

INDEX = REFRACTIONS["water"].n
TAG_PX = (40.0, 150.0)
MAX_TILT_RAD = 0.7


class WaterCamera(CameraModel, frozen=True):
    """A camera in air whose rays are turned at a thin window by Snell's law, ray by ray."""

    def directions(self, points_px: Points) -> Points:
        """Return where pixels look to in water."""
        air = CameraModel.directions(self, points_px)
        sine = air / np.sqrt(1 + (air**2).sum(axis=1, keepdims=True)) / INDEX
        return sine / np.sqrt(1 - (sine**2).sum(axis=1, keepdims=True))

    def direction(self, x_px: float, y_px: float) -> tuple[float, float]:
        """Return where one pixel looks to in water."""
        x, y = self.directions(np.array([[x_px, y_px]]))[0]
        return float(x), float(y)

    def project(self, directions: Points) -> Points:
        """Return at which pixels directions in water appear."""
        sine = directions / np.sqrt(1 + (directions**2).sum(axis=1, keepdims=True)) * INDEX
        air = sine / np.sqrt(1 - (sine**2).sum(axis=1, keepdims=True))
        return CameraModel.project(self, air)


# A distortion of zeros, so that the scenes' lens asks for directions.
CAMERA = replace(
    WaterCamera.with_focal_length(draw.CAMERA.fx_px, draw.CAMERA.width_px, draw.CAMERA.height_px), distortion=(0.0,) * 4
)
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
