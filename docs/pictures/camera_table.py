"""The tables of docs/choosing-a-camera.md, computed with the same model of uncertainty that `check` uses.

``python docs/pictures/camera_table.py`` writes them into the page.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

from msgspec import Struct

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import TargetShape
from stadimeter.ranging.ball import BallShape
from stadimeter.ranging.flat import SheetShape, TagShape
from stadimeter.ranging.similar_triangles import expect, farthest_m

PAGE = Path(__file__).parents[1] / "choosing-a-camera.md"
MARKED = re.compile(r"(<!-- table: (\w+) -->\n).*?(<!-- end of table -->\n)", re.DOTALL)

WIDTH_PX = 1280


class Camera(Struct, frozen=True):
    """A camera by its data sheet.

    Attributes:
        across: Angle of view across the picture, as its maker gives it or as it follows from that.
        aspect: Height over width of its pictures.
    """

    name: str
    across_rad: float
    aspect: float

    def model(self, width_px: int) -> CameraModel:
        """Return the ideal camera model for pictures of a width."""
        focal_px = width_px / 2 / math.tan(self.across_rad / 2)
        return CameraModel.with_focal_length(focal_px, width_px, round(width_px * self.aspect))


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
GLOBAL_SHUTTER_MM = (1456 * 3.45e-3, 1088 * 3.45e-3)

CAMERAS = (
    by_angle("Raspberry Pi Camera Module 2", 62.2, 3 / 4),
    by_angle("Raspberry Pi Camera Module 3", 66.0, 9 / 16),
    by_angle("Raspberry Pi Camera Module 3 Wide", 102.0, 9 / 16),
    by_lens("Raspberry Pi HQ Camera, 6 mm lens", 6.0, HQ_MM),
    by_lens("Raspberry Pi HQ Camera, 16 mm lens", 16.0, HQ_MM),
    by_lens("Raspberry Pi Global Shutter Camera, 6 mm lens", 6.0, GLOBAL_SHUTTER_MM),
    by_diagonal("USB webcam, 55° diagonal (such as a Logitech C270)", 55.0, 9 / 16),
    by_diagonal("USB webcam, 78° diagonal (such as a Logitech C920)", 78.0, 9 / 16),
)

BALL = BallShape(diameter_m=0.064)
SHEET = SheetShape(width_m=0.297, height_m=0.21)
TAG = TagShape(side_m=0.08)


def cameras_table() -> str:
    """Return what each camera reaches with pictures of `WIDTH_PX`."""
    head = (
        "| camera | across | f | ball 6.4 cm at 1 m | at 3 m | tag 8 cm at 1 m | at 3 m | A4 at 3 m | ball up to |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    )
    return "\n".join([*head, *(_row(camera) for camera in CAMERAS), ""])


def _row(camera: Camera) -> str:
    model = camera.model(WIDTH_PX)
    cells = [f"{math.degrees(camera.across_rad):.0f}°", f"{model.fx_px:.0f} px"]
    asked: tuple[tuple[TargetShape, float], ...] = ((BALL, 1), (BALL, 3), (TAG, 1), (TAG, 3), (SHEET, 3))
    cells += [_sigma(shape, model, distance_m) for shape, distance_m in asked]
    cells.append(f"{farthest_m(BALL, model):.1f} m")
    return f"| {camera.name} | {' | '.join(cells)} |"


def sizes_table() -> str:
    """Return what more pixels bring with one camera."""
    camera = CAMERAS[-1]
    head = ("| pictures | f | ball 6.4 cm at 3 m | tag 8 cm at 3 m | ball up to |", "| --- | --- | --- | --- | --- |")
    rows = []
    for width_px in (640, 1280, 1920):
        model = camera.model(width_px)
        sigmas = f"{_sigma(BALL, model, 3)} | {_sigma(TAG, model, 3)}"
        size = f"{model.width_px} × {model.height_px}"
        rows.append(f"| {size} | {model.fx_px:.0f} px | {sigmas} | {farthest_m(BALL, model):.1f} m |")
    return "\n".join([*head, *rows, ""])


def _sigma(shape: TargetShape, model: CameraModel, distance_m: float) -> str:
    expected = expect(shape, model, distance_m)
    if not expected.is_reliable:
        return "too small"
    sigma_mm = 1000 * expected.noise_m
    return f"± {sigma_mm:.1f} mm" if sigma_mm < 10 else f"± {sigma_mm / 10:.1f} cm"


TABLES: dict[str, Callable[[], str]] = {"cameras": cameras_table, "sizes": sizes_table}


def with_tables(page: str) -> str:
    """Return the page with its tables computed now."""
    return MARKED.sub(lambda found: f"{found[1]}\n{TABLES[found[2]]()}\n{found[3]}", page)


def write() -> None:
    """Write the tables into the page."""
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    write()
