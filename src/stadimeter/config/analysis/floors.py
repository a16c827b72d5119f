"""Targets on the floor whose distance by it cannot be: the camera's height is not known, or it sees no floor."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from stadimeter.config.analysis import Subject
from stadimeter.config.draft import BASE_NAME, Draft
from stadimeter.config.findings import Finding
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Footing

# A target whose centre is as high as the camera is level with it at every distance.
LEVEL_M = 0.01


def floor_errors(subject: Subject) -> Iterator[Finding]:
    """Find targets on the floor that the camera cannot measure by it."""
    draft = subject.draft
    standing = {name: table for name, table in draft.target_tables.items() if table.on_floor is not False}
    for name, table in standing.items():
        at = ("targets", name, "on_floor")
        if draft.camera_table.height is None:
            hint = 'measure it and add such as height = "30 cm" to [camera], or run `stadimeter calibrate floor`'
            yield Finding(at, "how high the camera is above the floor is not known", hint, "height-unknown")
        elif (footing := draft.camera_table.footing(table)) is not None and _is_level(footing):
            message = f"its centre is as high as the camera, {footing.centre_m:g} m, so the floor tells no distance"
            yield Finding(at, message, "leave on_floor out, or mount the camera higher", "floor-unseen")
    footing = next((found for table in standing.values() if (found := draft.camera_table.footing(table))), None)
    if footing is not None:
        yield from _camera(draft, footing)


def _is_level(footing: Footing) -> bool:
    centre_m, height_m = footing.centre_m, footing.height_m
    return centre_m is not None and height_m > 0 and abs(height_m - centre_m) < LEVEL_M


def _camera(draft: Draft, footing: Footing) -> Iterator[Finding]:
    if footing.height_m == 0:
        hint = 'write how high its lens is, such as height = "30 cm", or leave on_floor out'
        yield Finding(("camera", "height"), "a camera at 0 m above the floor sees none of it", hint, "floor-unseen")
    elif draft.camera_model is not None and not _is_floor_seen(draft.camera_model, footing.tilt_rad):
        message = f"looking up by {math.degrees(footing.tilt_rad):g}°, the camera has the floor below its picture"
        hint = 'below zero is down, such as tilt = "-12 deg"; or leave on_floor out'
        yield Finding(("camera", "tilt"), message, hint, "floor-unseen")
    options = draft.base.options if draft.base is not None else None
    if getattr(options, "tilt", None) is not None:
        message = "the base tilts the camera, so its tilt above the floor is not known"
        yield Finding((BASE_NAME, "tilt"), message, "leave on_floor out, or the tilt of the base", "floor-unseen")


def _is_floor_seen(lens: CameraModel, tilt_rad: float) -> bool:
    right, bottom = lens.width_px - 1.0, lens.height_px - 1.0
    corners = np.array([(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)])
    # A direction falls towards the floor where y cos t - sin t is above zero.
    return bool((lens.directions(corners)[:, 1] * math.cos(tilt_rad) > math.sin(tilt_rad)).any())
