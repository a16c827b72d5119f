"""Tables and drawings in the documentation are what the program gives now."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import accuracy_tables
import camera_table
import fleet_picture
import make_pictures
import moving_picture
import pytest
from PIL import Image

from stadimeter.config.loader import load_configuration
from stadimeter.workbench.printing import svg_of
from stadimeter.workbench.setup.recipes import load_recipes
from stadimeter.workbench.wiring import wiring_picture

ROOT = Path(__file__).resolve().parents[2]


def test_the_table_of_cameras_is_the_one_that_is_computed_now():
    page = camera_table.PAGE.read_text(encoding="utf-8")
    assert camera_table.table() in page, "run python docs/pictures/camera_table.py"


def test_the_moving_picture_fits_into_a_page_and_the_script_of_all_pictures_makes_it():
    script = Path(make_pictures.__file__).read_text(encoding="utf-8")
    assert f'make_moving_picture(HERE / "{moving_picture.PATH.name}")' in script
    assert moving_picture.PATH.stat().st_size <= moving_picture.BYTES_MAX
    with Image.open(moving_picture.PATH) as kept:
        assert (kept.size, kept.n_frames > 30) == (moving_picture.SIZE, True)


@pytest.mark.long
def test_the_moving_picture_shows_each_rule_of_the_demonstration_acting_and_at_rest():
    with Image.open(moving_picture.PATH) as kept:
        frames = kept.n_frames
    # The robot is behind a real serial port: on a busy machine it may be late, and not near enough once.
    assert any(shows_each_rule(moving_picture.watch_demonstration(), frames) for _ in range(4)), "run make pictures"


def shows_each_rule(moments, frames):
    acting = {rule: {each.active[rule] for each in moments} for rule in ("near", "far", "follow")}
    is_whole = len(moments) == frames and all(len(each.outline) for each in moments)
    levels = {each.levels["buzzer"] for each in moments}
    return is_whole and all(acting[rule] == {False, True} for rule in acting) and levels == {0.0, 1.0}


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


def test_the_figures_of_accuracy_are_those_of_the_report_and_of_its_goals():
    page = accuracy_tables.PAGE.read_text(encoding="utf-8")
    assert page.count("<!-- table: ") == len(accuracy_tables.tables())
    assert accuracy_tables.with_tables(page) == page, "run python docs/pictures/accuracy_tables.py"
    wanted = tomllib.loads((ROOT / "tests" / "benchmarks" / "goals.toml").read_text(encoding="utf-8"))
    reported = accuracy_tables.goals()
    assert {each["what"]: each["reach"] for group in wanted.values() for each in group}.items() <= {
        what: goal.reach for what, goal in reported.items()
    }.items()


def test_each_picture_of_how_it_measures_is_made_by_a_script():
    page = (ROOT / "docs" / "how-it-measures.md").read_text(encoding="utf-8")
    scripts = "".join(each.read_text(encoding="utf-8") for each in (ROOT / "docs" / "pictures").glob("*.py"))
    pictures = re.findall(r"^!\[[^]]+\]\(pictures/([^)]+)\)$", page, re.MULTILINE)
    assert pictures
    assert [name for name in pictures if f'"{name}"' not in scripts] == []
