"""Warnings about directions that are not in the picture."""

from __future__ import annotations

import math
from collections.abc import Iterator

from stadimeter.config.findings import Finding
from stadimeter.config.toml_lines import KeyPath
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.condition import Direction, DirectionCondition


class FieldOfView:
    """Directions that a camera sees along the middle of its picture; lens distortion at its edge is left out."""

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera

    def ends_rad(self, quantity: Direction) -> tuple[float, float]:
        """Return the lowest and the highest bearing (positive to the right) or elevation (positive upwards)."""
        model = self.camera
        if quantity == "bearing":
            return -math.atan(model.cx_px / model.fx_px), math.atan((model.width_px - 1 - model.cx_px) / model.fx_px)
        return -math.atan((model.height_px - 1 - model.cy_px) / model.fy_px), math.atan(model.cy_px / model.fy_px)


def direction_findings(at: KeyPath, condition: DirectionCondition, view: FieldOfView) -> Iterator[Finding]:
    """Find conditions on directions that begin, or end, outside the picture only."""
    low_rad, high_rad = view.ends_rad(condition.quantity)
    seen = f"the camera sees from {_degrees(low_rad)} to {_degrees(high_rad)}"
    above_rad = -math.inf if condition.above_rad is None else condition.above_rad
    below_rad = math.inf if condition.below_rad is None else condition.below_rad
    if above_rad >= high_rad or below_rad <= low_rad:
        message = f"no {condition.quantity} in the picture meets this: {seen}"
        yield Finding(at, message, "choose a limit within that, or a wider lens", "unreachable")
    elif above_rad - condition.deadband_rad <= low_rad and below_rad + condition.deadband_rad >= high_rad:
        message = f"with its deadband of {_degrees(condition.deadband_rad)} this ends outside the picture only: {seen}"
        yield Finding(at, message, "make the deadband smaller, or choose another limit", "unresolvable")


def _degrees(angle_rad: float) -> str:
    return f"{math.degrees(angle_rad):.0f}°"
