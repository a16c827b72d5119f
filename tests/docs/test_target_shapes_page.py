"""The shape that the page on target shapes makes, as a stranger would use it."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, TargetShape
from stadimeter.ranging.measure import measure
from stadimeter.ranging.similar_triangles import expect

PAGE = Path(__file__).resolve().parents[2] / "docs" / "target-shapes.md"
CAMERA = CameraModel.with_focal_length(600.0, 640, 480)


def pole(height_m: float) -> TargetShape:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    names: dict[str, type] = {}
    exec(compile(code, str(PAGE), "exec"), names)  # noqa: S102 - the page's own example
    made: TargetShape = names["Pole"](height_m=height_m)
    return made


def test_the_shape_of_the_page_is_measured_and_has_expectations():
    seen = Detection(
        target="pole",
        status=DetectionStatus.FOUND,
        centre_px=(CAMERA.cx_px, CAMERA.cy_px),
        width_px=12.0,
        height_px=300.0,
        size_sigma_px=0.3,
    )
    measured = measure(seen, pole(2.0), CAMERA, 0.0)
    assert measured.distance_m == pytest.approx(4.0)
    assert measured.sigma_m == pytest.approx(4.0 * 0.3 / 300)
    assert expect(pole(2.0), CAMERA, 4.0).size_px == pytest.approx(300.0)


def test_the_page_names_every_member_of_a_shape():
    members = {name for name in vars(TargetShape) if not name.startswith("_")}
    text = PAGE.read_text(encoding="utf-8")
    assert all(f"`{name}" in text for name in members)
