"""`stadimeter site`: saving a view, comparing with it, and a run that watches it."""

from __future__ import annotations

import json
import math
from pathlib import Path

import cv2
import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.loop import Loop
from stadimeter.app.mounting import watch_of
from stadimeter.cli import run_services
from stadimeter.config.loader import load_configuration
from support.command_line import typed
from support.watched_room import FOCAL_PX, Pose, WatchedRoom

CONFIGURATION = f"""
[camera]
driver = "images"
paths = "shots"
rate = "4 Hz"

[camera.model]
width_px = 640
height_px = 480
fx_px = {FOCAL_PX}

[targets.tag]
detector = "tag"
side = "10 cm"
id = 1
"""


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A configuration whose camera shows a dozen pictures of a room."""
    shots = tmp_path / "shots"
    shots.mkdir()
    write(shots, Pose())
    (tmp_path / "run.toml").write_text(CONFIGURATION)
    return tmp_path / "run.toml"


def write(shots: Path, pose: Pose) -> None:
    room = WatchedRoom(seed=61)
    for at in range(3):
        for each, image in enumerate(room.pictures(720, pose)):
            cv2.imwrite(str(shots / f"{4 * at + each:02}.png"), image)


@pytest.mark.long
def test_a_view_is_saved_beside_the_configuration_and_compared_with(site) -> None:
    saved = typed("site", "save", site)
    assert saved.returncode == 0, saved.stderr
    assert "run.mounting" in saved.stdout
    same = typed("site", "check", site)
    assert same.returncode == 0, same.stdout + same.stderr
    assert same.stdout.startswith("as saved: pan ")
    write(site.parent / "shots", Pose(pan_deg=0.5))
    moved = typed("site", "check", site)
    assert moved.returncode == 1
    assert moved.stdout.startswith("not as saved (moved): pan +0.")
    record = json.loads(typed("site", "check", site, "--json").stdout)
    assert [*record["findings"]] == ["moved"]
    assert record["compared"]["motion"]["pan_rad"] == pytest.approx(math.radians(0.5), rel=0.1)


@pytest.mark.long
def test_without_a_saved_view_the_answer_names_the_command_that_saves_one(site) -> None:
    missing = typed("site", "check", site)
    assert missing.returncode == 2
    assert "stadimeter site save" in missing.stderr


def test_too_few_pictures_save_nothing(site) -> None:
    for name in ("10.png", "11.png"):
        (site.parent / "shots" / name).unlink()
    refused = typed("site", "save", site)
    assert refused.returncode == 2
    assert "ends before 12 pictures" in refused.stderr
    assert not site.with_suffix(".mounting").exists()


@pytest.mark.long
def test_a_run_of_a_live_camera_watches_as_soon_as_a_view_was_saved(site, monkeypatch) -> None:
    def watched(text: str = CONFIGURATION):
        site.write_text(text)
        loop = Loop(build(load_configuration(site), speed=None))
        loop.parts.is_live = True
        with run_services._watch_mounting(loop):
            return loop.parts.cycle.mounting_watch

    assert watched() is None
    typed("site", "save", site)
    assert watched() is not None
    assert watched(CONFIGURATION + "[mounting]\nwatch = false\n") is None
    site.with_suffix(".mounting").write_bytes(b"damaged")
    assert watched() is None


def test_a_wanted_watch_without_a_saved_view_is_said(site) -> None:
    site.write_text(CONFIGURATION + "[mounting]\nwatch = true\n")
    watch, why = watch_of(load_configuration(site))
    assert watch is None
    assert "mounting.watch = true" in why
