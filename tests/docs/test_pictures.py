"""Tables and drawings in the documentation are what the program gives now."""

from __future__ import annotations

import re
from pathlib import Path

import camera_table
import fleet_picture
import make_pictures

from stadimeter.config.loader import load_configuration
from stadimeter.workbench.printing import svg_of
from stadimeter.workbench.setup.recipes import load_recipes
from stadimeter.workbench.wiring import wiring_picture

ROOT = Path(__file__).resolve().parents[2]


def test_the_tables_of_cameras_are_those_that_are_computed_now():
    page = camera_table.PAGE.read_text(encoding="utf-8")
    assert page.count("<!-- table: ") == len(camera_table.TABLES)
    assert camera_table.with_tables(page) == page, "run python docs/pictures/camera_table.py"


def test_the_drawing_of_the_example_is_that_of_its_configuration():
    drawn = svg_of(wiring_picture(load_configuration(ROOT / "config" / "distance-alert.toml").actuators))
    kept = (ROOT / "docs" / "pictures" / "wiring-distance-alert.svg").read_text(encoding="utf-8")
    assert kept == drawn, "run make pictures"


def test_the_drawing_of_the_first_beep_is_that_of_the_configuration_on_its_page():
    kept = (ROOT / "docs" / "pictures" / "wiring-first-beep.svg").read_text(encoding="utf-8")
    assert kept == svg_of(wiring_picture(make_pictures.first_beep())), "run make pictures"


def test_the_buzzer_of_the_first_beep_is_on_the_pin_that_init_offers():
    (buzzer,) = [part for part in make_pictures.first_beep() if part.driver == "buzzer"]
    offered = load_recipes()["near"].output
    assert offered == f"buzzer {buzzer.options.pin}"
    assert f"`{offered}`" in (ROOT / "docs" / "raspberry-pi.md").read_text("utf-8")


def test_the_view_of_a_fleet_is_what_the_program_shows_now(tmp_path):
    fleet_picture.draw(tmp_path / "fleet-view.svg")
    kept = (ROOT / "docs" / "pictures" / "fleet-view.svg").read_text(encoding="utf-8")
    assert kept == (tmp_path / "fleet-view.svg").read_text(encoding="utf-8"), "run make pictures"


def test_each_way_of_measuring_has_a_section_and_a_picture_that_a_script_makes():
    page = (ROOT / "docs" / "how-it-measures.md").read_text(encoding="utf-8")
    sections = dict(part.split("\n", 1) for part in page.split("\n## ")[1:])
    scripts = "".join(each.read_text(encoding="utf-8") for each in (ROOT / "docs" / "pictures").glob("*.py"))
    ways = sections.keys() - {"The four steps", "Found, perhaps or refused", "From measurements to a track"}
    assert {"Three circles", "Under water", "Picture", "On the floor"} <= ways
    for way in ways:
        pictures = re.findall(r"^!\[[^]]+\]\(pictures/([^)]+)\)$", sections[way], re.MULTILINE)
        assert pictures, way
        assert all(f'"{name}"' in scripts for name in pictures), pictures
