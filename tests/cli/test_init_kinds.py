"""`init` for what a network finds, pictures, several of one kind, and what is known of floor, water and places."""

from __future__ import annotations

import json
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import ClassVar

import cv2
import numpy as np
import pytest

from stadimeter.config import plugins
from stadimeter.config.camera_file import save_camera_model
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.detectors.disc import DiscOptions
from stadimeter.detectors.protocol import SetupKind, size_question
from stadimeter.workbench.setup.interview import save_answers
from support.command_line import Typed, typed
from support.networks import write_network
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.cut_sheet import GroupTarget
from support.scenes.render import render
from support.scenes.scene import Scene

pytestmark = [pytest.mark.vision, pytest.mark.timeout(300)]

LENS = CameraModel.with_focal_length(600.0, 640, 480)
COLOUR = "20,60,40:50,255,255"
BALL_M = 0.2
NEAR, BESIDE, FAR = (-0.4, 0.0, 1.5), (0.4, 0.05, 1.7), (0.05, 0.0, 2.5)


def init(folder: Path, **answers: str) -> Typed:
    save_camera_model(folder / "camera.toml", LENS)
    save_answers(folder / "given.toml", {"camera": "*.png", "calibration": "camera.toml", **answers})
    return typed("init", folder, "--answers", folder / "given.toml")


def works(folder: Path, told: Typed) -> Configuration:
    """Return the configuration that was written: `check` finds nothing in it, and `run` runs it."""
    assert told.returncode == 0, told
    checked = typed("check", "--strict", folder / "stadimeter.toml")
    assert (checked.returncode, "warning:" in checked.stdout + checked.stderr) == (0, False), checked
    ran = typed("run", folder / "stadimeter.toml", "--no-state", "--speed", "0", "--seconds", "1")
    assert ran.returncode == 0, ran
    return load_configuration(folder / "stadimeter.toml")


def balls(*places: tuple[float, float, float]) -> Image:
    first, *others = (BallTarget(position_m=place, diameter_m=BALL_M) for place in sorted(places, key=lambda p: p[2]))
    target = GroupTarget(first=first, others=tuple(others)) if others else first
    return render(Scene(camera=LENS, target=target, seed=1, backdrop=PlainBackdrop())).image


def measured(folder: Path, picture: str) -> dict[str, float | None]:
    told = typed("measure", folder / picture, "--config", folder / "stadimeter.toml", "--json")
    results = [json.loads(line) for line in told.stdout.splitlines()]
    return {each["target"]: each["distance_m"] for each in results}


@pytest.mark.parametrize(
    ("answers", "key", "words"),
    [
        ({"target": "person", "model": "given.toml"}, "model", "given.toml"),
        ({"target": "picture", "picture": "none.jpg"}, "size", "none.jpg cannot be read"),
        ({"target": "balls", "size": "20 cm", "number": "many"}, "number", "'many'"),
        ({"target": "tags", "size": "20 cm", "tags": "36h11 3 3"}, "tags", "3 is given twice"),
        ({"target": "ball", "size": "20 cm", "colour": COLOUR, "wish": "crowd"}, "wish", "for several of one kind"),
    ],
)
def test_what_cannot_be_used_is_named_with_its_question(
    tmp_path: Path, answers: dict[str, str], key: str, words: str
) -> None:
    cv2.imwrite(str(tmp_path / "1m.png"), balls(NEAR))
    write_network(tmp_path / "mine.onnx", "yolox")
    told = init(tmp_path, **answers)
    assert told.returncode == 2, told
    assert f"given.toml: {key}: " in told.stderr
    assert words in told.stderr


@pytest.mark.long
def test_several_balls_are_set_up_counted_and_measured_each_by_its_name(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "three.png"), balls(NEAR, BESIDE, FAR))
    told = init(tmp_path, target="balls", size="20 cm", number="4", colour=COLOUR, wish="near crowd", crowd_near="3 m")
    configuration = works(tmp_path, told)
    assert configuration.plan.measured_targets == tuple(f"balls-{number}" for number in (1, 2, 3, 4))
    assert configuration.plan.rules[0].target == "balls-nearest"
    distances = measured(tmp_path, "three.png")
    assert list(distances) == ["balls-1", "balls-2", "balls-3"], "the largest first, and none for what is not there"
    truths_m = [float(np.hypot.reduce(place)) for place in (NEAR, BESIDE, FAR)]
    assert [*distances.values()] == pytest.approx(truths_m, rel=0.02)
    between = typed(
        "measure", tmp_path / "three.png", "--config", tmp_path / "stadimeter.toml", "--between", "balls-1,balls-3"
    )
    assert "balls-1" in between.stdout.splitlines()[-1]
    ran = typed("run", tmp_path / "stadimeter.toml", "--no-state", "--speed", "0", "--seconds", "3")
    assert "crowd raised" in ran.stdout


class CoinOptions(DiscOptions):
    """A detector of another package."""

    kinds: ClassVar[tuple[SetupKind, ...]] = (
        SetupKind("coin", "a coin", (size_question("coin", lambda size: {"diameter": size}, "23 mm", "its diameter"),)),
    )

    @staticmethod
    def setup_kinds() -> tuple[SetupKind, ...]:
        return CoinOptions.kinds


@pytest.mark.long
def test_a_detector_of_another_package_is_offered_with_its_own_question(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry = EntryPoint(name="coin", value=f"{__name__}:CoinOptions", group=plugins.DETECTORS)
    known = (*entry_points(group=plugins.DETECTORS), entry)
    monkeypatch.setattr(plugins, "installed", lambda group: known if group == plugins.DETECTORS else ())
    cv2.imwrite(str(tmp_path / "1m.png"), balls(NEAR))
    told = init(tmp_path, target="cube")
    kinds = "ball, sheet, tag, disc, picture, circles, person, face, object, balls, tags, coin"
    assert f"'cube' is none of {kinds}" in told.stderr
    told = init(tmp_path, target="coin", size="20 cm")
    assert load_configuration(tmp_path / "stadimeter.toml").targets[0].driver == "coin", told
