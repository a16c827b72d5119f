"""Tables and drawings in the documentation are what the program gives now."""

from __future__ import annotations

from pathlib import Path

import camera_table
import make_pictures
import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.workbench.drawing.svg import svg_of
from stadimeter.workbench.wiring.picture import wiring_picture

ROOT = Path(__file__).resolve().parents[2]


def test_the_tables_of_cameras_are_those_that_are_computed_now() -> None:
    page = camera_table.PAGE.read_text(encoding="utf-8")
    assert page.count("<!-- table: ") == len(camera_table.TABLES)
    assert camera_table.with_tables(page) == page, "run python docs/pictures/camera_table.py"


def test_a_camera_by_its_angle_by_its_diagonal_and_by_its_lens_is_the_same() -> None:
    lens = camera_table.by_lens("", 6.0, (6.4, 4.8))
    assert lens.model(1280).fx_px == pytest.approx(1280 * 6.0 / 6.4)
    angle = camera_table.by_angle("", 56.145, 0.75)
    diagonal = camera_table.by_diagonal("", 67.380, 0.75)
    assert angle.across_rad == pytest.approx(lens.across_rad, abs=1e-4)
    assert diagonal.across_rad == pytest.approx(lens.across_rad, abs=1e-4)


def test_the_drawing_of_the_example_is_that_of_its_configuration() -> None:
    drawn = svg_of(wiring_picture(load_configuration(ROOT / "config" / "distance-alert.toml").actuators))
    kept = (ROOT / "docs" / "pictures" / "wiring-distance-alert.svg").read_text(encoding="utf-8")
    assert kept == drawn, "run make pictures"


def test_the_drawing_of_the_first_beep_is_that_of_the_configuration_on_its_page() -> None:
    kept = (ROOT / "docs" / "pictures" / "wiring-first-beep.svg").read_text(encoding="utf-8")
    assert kept == svg_of(wiring_picture(make_pictures.first_beep())), "run make pictures"
