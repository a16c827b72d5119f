"""The table of docs/cameras.md, computed with the same model of uncertainty that `check` uses.

``python docs/pictures/camera_table.py`` writes it into the page.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import TargetShape
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.flat import TagShape
from stadimeter.ranging.similar_triangles import expect, farthest_m

PAGE = Path(__file__).parents[1] / "cameras.md"
MARKED = re.compile(r"(<!-- table -->\n).*?(<!-- end of table -->\n)", re.DOTALL)

WIDTH_PX = 1280


class Camera(Struct, frozen=True):
    """A camera by its data sheet.

    Attributes:
        across_rad: Angle of view across the picture, as its maker gives it or as it follows from that.
        aspect: Height over width of its pictures.
    """

    name: str
    across_rad: float
    aspect: float

    def model(self) -> CameraModel:
        """Return the ideal camera model for pictures of `WIDTH_PX`."""
        focal_px = WIDTH_PX / 2 / math.tan(self.across_rad / 2)
        return CameraModel.with_focal_length(focal_px, WIDTH_PX, round(WIDTH_PX * self.aspect))


def by_angle(name: str, across_deg: float, aspect: float) -> Camera:
    """Return a camera whose maker gives the angle of view across."""
    return Camera(name, math.radians(across_deg), aspect)


def by_diagonal(name: str, diagonal_deg: float, aspect: float) -> Camera:
    """Return a camera whose maker gives the angle of view across the diagonal."""
    half = math.tan(math.radians(diagonal_deg) / 2) / math.hypot(1, aspect)
    return Camera(name, 2 * math.atan(half), aspect)


def by_lens(name: str, focal_mm: float, sensor_mm: tuple[float, float]) -> Camera:
    """Return a camera with a lens of a focal length before a sensor of a size."""
    width_mm, height_mm = sensor_mm
    return Camera(name, 2 * math.atan(width_mm / 2 / focal_mm), height_mm / width_mm)


HQ_MM = (4056 * 1.55e-3, 3040 * 1.55e-3)

CAMERAS = (
    by_angle("Raspberry Pi Camera Module 3", 66.0, 9 / 16),
    by_angle("Raspberry Pi Camera Module 3 Wide", 102.0, 9 / 16),
    by_lens("Raspberry Pi HQ Camera, 16 mm lens", 16.0, HQ_MM),
    by_diagonal("webcam, 55° diagonal (Logitech C270)", 55.0, 9 / 16),
    by_diagonal("webcam, 78° diagonal (Logitech C920)", 78.0, 9 / 16),
)

BALL = BallShape(diameter_m=0.064)
TAG = TagShape(side_m=0.08)


def table() -> str:
    """Return what each camera reaches."""
    head = ("| camera | sees | tennis ball at 3 m | up to | tag of 8 cm at 3 m |", "| --- | --- | --- | --- | --- |")
    return "\n".join([*head, *map(_row, CAMERAS), ""])


def _row(camera: Camera) -> str:
    model = camera.model()
    sees = f"{math.degrees(camera.across_rad):.0f}°"
    reach = f"{farthest_m(BALL, model):.1f} m"
    return f"| {camera.name} | {sees} | {_sigma(BALL, model)} | {reach} | {_sigma(TAG, model)} |"


def _sigma(shape: TargetShape, model: CameraModel) -> str:
    expected = expect(shape, model, 3.0)
    if not expected.is_reliable:
        return "too small"
    sigma_mm = 1000 * expected.noise_m
    return f"± {sigma_mm:.1f} mm" if sigma_mm < 10 else f"± {sigma_mm / 10:.1f} cm"


def with_table(page: str) -> str:
    """Return the page with its table computed now."""
    return MARKED.sub(lambda found: f"{found[1]}\n{table()}\n{found[2]}", page)


def write() -> None:
    """Write the table into the page."""
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    write()
