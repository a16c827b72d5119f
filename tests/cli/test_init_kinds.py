"""`init` for what a network finds, pictures, several of one kind, and what is known of floor, water and places."""

from __future__ import annotations

import json
import re
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import ClassVar

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from stadimeter.cli.main import app
from stadimeter.config import plugins
from stadimeter.config.camera_file import save_camera_model
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.stereo_file import stereo_file_text
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.detectors.disc import DiscOptions
from stadimeter.detectors.protocol import SetupKind, size_question
from stadimeter.workbench.setup.interview import save_answers
from support import two_cameras
from support.detector_rigs import poster_file
from support.networks import EYES, bright_figure, put_figure, write_network
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.cut_sheet import GroupTarget
from support.scenes.plane import Pose, TagTarget
from support.scenes.poster import poster_scene
from support.scenes.render import render
from support.scenes.scene import Scene

pytestmark = [pytest.mark.vision, pytest.mark.timeout(300)]

LENS = CameraModel.with_focal_length(600.0, 640, 480)
COLOUR = "20,60,40:50,255,255"
BALL_M = 0.2
NEAR, BESIDE, FAR = (-0.4, 0.0, 1.5), (0.4, 0.05, 1.7), (0.05, 0.0, 2.5)


def run(*arguments: object) -> Result:
    result = CliRunner().invoke(app, [*map(str, arguments)])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def init(folder: Path, **answers: str) -> Result:
    save_camera_model(folder / "camera.toml", LENS)
    save_answers(folder / "given.toml", {"camera": "*.png", "calibration": "camera.toml", **answers})
    return run("init", folder, "--answers", folder / "given.toml")


def works(folder: Path, told: Result) -> Configuration:
    """Return the configuration that was written: `check` finds nothing in it, and `run` runs it."""
    assert told.exit_code == 0, told.output
    checked = run("check", "--strict", folder / "stadimeter.toml")
    assert (checked.exit_code, "warning:" in checked.output) == (0, False), checked.output
    ran = run("run", folder / "stadimeter.toml", "--no-state", "--speed", "0", "--seconds", "1")
    assert ran.exit_code == 0, ran.output
    return load_configuration(folder / "stadimeter.toml")


def dark_room(height_px: int) -> Image:
    """Return a picture in which a network finds one bright thing of this height."""
    image = np.random.default_rng(0).integers(20, 90, (480, 640, 3), np.uint8)
    put_figure(image, bright_figure(height_px, round(0.4 * height_px)), 200, 100)
    return image


def balls(*places: tuple[float, float, float]) -> Image:
    first, *others = (BallTarget(position_m=place, diameter_m=BALL_M) for place in sorted(places, key=lambda p: p[2]))
    target = GroupTarget(first=first, others=tuple(others)) if others else first
    return render(Scene(camera=LENS, target=target, seed=1, backdrop=PlainBackdrop())).image


def measured(folder: Path, picture: str) -> dict[str, float | None]:
    told = run("measure", folder / picture, "--config", folder / "stadimeter.toml", "--json")
    results = [json.loads(line) for line in told.stdout.splitlines()]
    return {each["target"]: each["distance_m"] for each in results}


@pytest.mark.long
def test_a_person_is_set_up_with_a_network_of_this_folder_and_measured(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "person.png"), dark_room(300))
    write_network(tmp_path / "mine.onnx", "yolox")
    told = init(tmp_path, target="person", size="1.72 m ± 7 cm", near_near="4 m")
    assert "model = mine.onnx" in told.stdout, "the only network in the folder is ready"
    configuration = works(tmp_path, told)
    assert configuration.targets[0].options.class_name == "person"
    assert measured(tmp_path, "person.png")["person"] == pytest.approx(600 * 1.72 / 300, rel=0.05)


@pytest.mark.long
def test_a_face_is_set_up_by_its_eyes(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "face.png"), dark_room(200))
    write_network(tmp_path / "centerface.onnx", "centerface")
    works(tmp_path, init(tmp_path, target="face"))
    eyes_px = 0.4 * 200 * (EYES[1][0] - EYES[0][0])
    assert measured(tmp_path, "face.png")["face"] == pytest.approx(600 * 0.0634 / eyes_px, rel=0.1)


@pytest.mark.long
def test_another_object_is_set_up_by_its_class_and_height(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "dog.png"), dark_room(150))
    write_network(tmp_path / "mine.onnx", "yolox")
    answers = {"target": "object", "class": "person", "size": "1 m ± 10 cm", "near_near": "2 m"}
    configuration = works(tmp_path, init(tmp_path, **answers))
    assert configuration.targets[0].options.height == (1.0, 0.1)


@pytest.mark.parametrize(
    ("answers", "key", "words"),
    [
        ({"target": "person", "model": "none.onnx"}, "size", "none.onnx is not there"),
        ({"target": "person", "model": "given.toml"}, "model", "given.toml"),
        ({"target": "object", "model": "mine.onnx", "class": "cow"}, "class", "cow"),
        ({"target": "person", "model": "mine.onnx", "size": "17 m"}, "size", "is not the height of a person"),
        ({"target": "picture", "picture": "none.jpg"}, "size", "none.jpg cannot be read"),
        ({"target": "balls", "size": "20 cm", "number": "many"}, "number", "'many'"),
        ({"target": "balls", "size": "20 cm", "number": "2", "colour": "any"}, "colour", "add hsv beside count"),
        ({"target": "tags", "size": "20 cm", "tags": "36h11 3 3"}, "tags", "3 is given twice"),
        ({"target": "tags", "size": "20 cm", "tags": ","}, "tags", "family"),
        ({"target": "tags", "size": "20 cm", "tags": "36h11 any 99"}, "tags", "99 is above 64"),
        ({"target": "ball", "size": "20 cm", "colour": COLOUR, "wish": "crowd"}, "wish", "for several of one kind"),
    ],
)
def test_what_cannot_be_used_is_named_with_its_question(
    tmp_path: Path, answers: dict[str, str], key: str, words: str
) -> None:
    cv2.imwrite(str(tmp_path / "1m.png"), balls(NEAR))
    write_network(tmp_path / "mine.onnx", "yolox")
    told = init(tmp_path, **answers)
    assert told.exit_code == 2, told.output
    assert f"given.toml: {key}: " in told.stderr
    assert words in told.stderr


@pytest.mark.long
def test_a_picture_is_set_up_from_a_file_that_shows_it(tmp_path: Path) -> None:
    scene = poster_scene(1, 200, 0.2)
    made = render(scene)
    cv2.imwrite(str(tmp_path / "room.png"), made.image)
    save_camera_model(tmp_path / "lens.toml", scene.camera)
    told = init(
        tmp_path,
        camera="room.png",
        target="picture",
        picture=str(poster_file(1)),
        size="40 cm",
        calibration="lens.toml",
    )
    works(tmp_path, told)
    assert measured(tmp_path, "room.png")["picture"] == pytest.approx(made.truth.distance_m, rel=0.01)


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
    between = run(
        "measure", tmp_path / "three.png", "--config", tmp_path / "stadimeter.toml", "--between", "balls-1,balls-3"
    )
    assert "balls-1" in between.stdout.splitlines()[-1]
    ran = run("run", tmp_path / "stadimeter.toml", "--no-state", "--speed", "0", "--seconds", "3")
    assert "crowd raised" in ran.stdout


@pytest.mark.long
def test_several_tags_are_set_up_by_their_numbers_and_a_missing_one_has_a_line(tmp_path: Path) -> None:
    tag = TagTarget(pose=Pose(position_m=(0.0, 0.0, 1.5)), side_m=0.2, family="apriltag-36h11", number=7)
    image = render(Scene(camera=LENS, target=tag, seed=1, backdrop=PlainBackdrop())).image
    cv2.imwrite(str(tmp_path / "one.png"), image)
    told = init(tmp_path, target="tags", size="20 cm", tags="36h11 3 7")
    assert told.exit_code == 1, "tag 3 is not in the last picture"
    assert "`tags-3` was not measured" in told.stdout
    distances = measured(tmp_path, "one.png")
    assert list(distances) == ["tags-3", "tags-7"]
    assert distances["tags-3"] is None
    assert distances["tags-7"] == pytest.approx(1.5, rel=0.01)


@pytest.mark.long
def test_a_size_that_is_not_known_is_learnt_from_pictures_that_come_nearer(tmp_path: Path) -> None:
    for number, near_m in enumerate((0.0, 0.2, 0.4)):
        cv2.imwrite(str(tmp_path / f"{number}.png"), balls((0.0, 0.0, 1.5 - near_m)))
    told = init(tmp_path, target="ball", size="unknown", colour=COLOUR, way="0.png 1.png@20cm 2.png@40cm")
    configuration = works(tmp_path, told)
    assert re.search(r"The ball measures \d+(\.\d+)? mm ± ", told.stdout)
    options = configuration.targets[0].options
    assert options.diameter == pytest.approx(BALL_M, abs=2 * options.tolerance)


@pytest.mark.long
def test_what_is_known_of_floor_water_and_places_is_asked_for_and_written(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "1m.png"), balls((0.0, 0.0, 1.5)))
    given = {"target": "ball", "size": "20 cm", "colour": COLOUR, "wish": "near floor water places"}
    refused = init(tmp_path, **given)
    assert "write medium and port_m into camera.toml" in refused.stderr
    told = init(tmp_path, **given, calibration="1m.png@1.5m", floor_height="30 cm ± 1 cm", floor_tilt="-2 deg")
    configuration = works(tmp_path, told)
    assert configuration.footings["ball"].height_m == pytest.approx(0.3)
    assert len(configuration.landmarks.tags) == 2
    assert configuration.camera_model.fx_px == pytest.approx(1.334 * 600, rel=0.01)


@pytest.mark.long
def test_a_second_camera_is_asked_for_and_measures_in_the_run_that_follows(tmp_path: Path) -> None:
    (tmp_path / "stereo.toml").write_text(stereo_file_text(two_cameras.BESIDE))
    given = {
        "camera": "simulated",
        "calibration": "60 deg",
        "target": "ball",
        "size": "7 cm",
        "wish": "floor stereo near",
    }
    refused = init(tmp_path, **given, stereo_file="other.toml")
    assert "stereo_file" in refused.stderr, "it is refused at its own question"
    told = init(tmp_path, **given, stereo_camera="simulated,baseline=12cm")
    configuration = works(tmp_path, told)
    assert configuration.second_camera is not None
    assert configuration.camera_model.fx_px == two_cameras.LENS.fx_px


@pytest.mark.long
def test_places_alone_are_set_up_and_the_next_command_says_where_the_camera_is(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "1m.png"), balls((0.0, 0.0, 1.5)))
    told = init(tmp_path, target="ball", size="20 cm", colour=COLOUR, wish="places")
    works(tmp_path, told)
    assert "stadimeter locate " in told.stdout


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
    assert load_configuration(tmp_path / "stadimeter.toml").targets[0].driver == "coin", told.output
