"""The interview before a live camera and with pictures, and what `init` writes of its answers."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.cli.main import app
from stadimeter.config.describe import describe
from stadimeter.config.driver_tables import BASE
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame, Image
from stadimeter.errors import ConfigError
from stadimeter.workbench.doctor.computer import Computer
from stadimeter.workbench.rule_tests.running import run_rule_test
from stadimeter.workbench.setup.camera_step import table_of
from stadimeter.workbench.setup.files import WISHES, Wish, base_table, configuration_files, ready_answers
from stadimeter.workbench.setup.interview import Interview, load_answers, save_answers
from stadimeter.workbench.setup.question import Known
from stadimeter.workbench.setup.wish_steps import (
    BaseStep,
    BlankStep,
    WishOutputStep,
    WishStep,
    option_steps,
    reliable_range_m,
)
from support.each_case import each_case
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.draw import CAMERA
from support.scenes.render import render
from support.scenes.scene import Scene
from support.v4l2_double import V4l2Double

pytestmark = pytest.mark.vision


# The interview before a live camera, a double of a device that shows rendered balls.

LENS = CameraModel.with_focal_length(600.0, 640, 480)
BALL_M = 0.2
COLOUR = "20,60,40:50,255,255"


@cache
def ball_at(near_side_m: float) -> Image:
    """Return a picture of a ball whose nearest point is that far from the lens."""
    ball = BallTarget(position_m=(0.0, 0.0, near_side_m + BALL_M / 2), diameter_m=BALL_M)
    return render(Scene(camera=LENS, target=ball, seed=1, backdrop=PlainBackdrop())).image


@pytest.fixture
def device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> V4l2Double:
    return V4l2Double.plugged_in(tmp_path / "video0", ball_at(1.0), monkeypatch)


def _camera(device: V4l2Double) -> str:
    return f"opencv,device={device.node}"


@pytest.fixture
def interview(tmp_path: Path, device: V4l2Double) -> Interview:
    """Return an interview up to the calibration."""
    begun = Interview(tmp_path)
    for answer in (_camera(device), "ball", "20 cm", COLOUR):
        begun.answer(answer)
    return begun


@pytest.mark.long
def test_a_ball_before_a_camera_takes_eight_answers(interview: Interview, device: V4l2Double) -> None:
    interview.answer("1 m")
    while (question := interview.question()) is not None:
        interview.answer(question.ready)
    known = interview.known
    assert len(known.answers) == 8
    assert known.camera_model is not None
    assert known.camera_model.fx_px == pytest.approx(600.0, rel=0.01)
    for name, text in configuration_files(known.answers, known.camera_model).items():
        (known.folder / name).write_text(text, encoding="utf-8")
    assert load_configuration(known.file).camera.options.device == str(device.node)


@pytest.mark.long
def test_another_interview_goes_on_where_one_was_left(interview: Interview, tmp_path: Path) -> None:
    interview.answer("1 m")
    again = Interview(tmp_path)
    resumed = [key for key, _ in again.resume(load_answers(interview.path))]
    assert resumed == ["camera", "target", "size", "colour", "calibration"]
    assert again.next_key == "wish"
    assert again.known.camera_model == interview.known.camera_model


def test_answers_may_be_numbers_and_lists_but_no_tables(tmp_path: Path) -> None:
    file = tmp_path / "answers.toml"
    file.write_text('camera = 0\ncalibration = ["a b.jpg@1m", "c.jpg@2m"]\n')
    assert load_answers(file) == {"camera": "0", "calibration": "'a b.jpg@1m' c.jpg@2m"}
    file.write_text("wish = { near = true }\n")
    with pytest.raises(ConfigError, match="an answer is text"):
        load_answers(file)


def test_a_camera_is_named_in_the_ways_that_people_know() -> None:
    for answer, table in [
        ("0", {"driver": "opencv", "device": 0}),
        ("/dev/video2", {"driver": "opencv", "device": "/dev/video2"}),
        ("opencv,device=0,exposure=5 ms", {"driver": "opencv", "device": 0, "exposure": "5 ms"}),
        ("/dev/video2,exposure=5ms", {"driver": "opencv", "device": "/dev/video2", "exposure": "5ms"}),
        ("http://10.0.0.9/a?b=c", {"driver": "opencv", "device": "http://10.0.0.9/a?b=c"}),
        ("picamera2", {"driver": "picamera2"}),
        ("drive.mp4", {"driver": "video", "path": "drive.mp4", "loop": True}),
        ("drive.mp4 loop=no", {"driver": "video", "path": "drive.mp4", "loop": False}),
        (
            "'my ball.jpg' b.png",
            {"driver": "images", "paths": ["my ball.jpg", "b.png"], "rate": "5 Hz", "dwell": "2 s", "loop": True},
        ),
        (
            "shots rate=1Hz dwell=0s loop=no",
            {"driver": "images", "paths": ["shots"], "rate": "1Hz", "dwell": "0s", "loop": False},
        ),
    ]:
        assert table_of(answer) == table


@pytest.mark.parametrize("driver", ["gpio-motors", "pca9685", "ros-arduino-bridge"])
def test_each_base_is_set_up_by_its_ready_answers_alone(tmp_path: Path, driver: str) -> None:
    known = Known(folder=tmp_path, answers={"wish": "follow"})
    assert known.answers.setdefault("base", BaseStep().accept(known, driver).answer) == driver
    for step in option_steps(driver):
        question = step.question(known)
        assert len(question.text) > len(f"{step.option}: "), "its description is the question"
        known.answers[step.key] = step.accept(known, question.ready).answer
    table = base_table(known.answers)
    choice = known.choose(BASE, ("base",), table)
    assert choice.driver == driver
    assert {key.removeprefix("base_") for key in known.answers if key.startswith("base_")} < set(table)


@pytest.mark.parametrize("answer", ['"', "\\", "a = b # c", "°", "\x7f"])
def test_answers_are_read_as_they_were_saved(tmp_path: Path, answer: str) -> None:
    save_answers(tmp_path / "answers.toml", {"size": answer})
    assert load_answers(tmp_path / "answers.toml") == {"size": answer}


# What `init` writes: every wish gives a configuration without a warning whose tests pass.

FRAME = Frame(image=np.zeros((480, 640, 3), np.uint8), captured_at_s=0.0, sequence=0)
TARGETS = {
    "ball": {"target": "ball", "size": "tennis ball", "colour": "29,86,6:64,255,255"},
    "tag": {"target": "tag", "size": "10 cm", "tag": "36h11 3"},
    "balls": {"target": "balls", "size": "tennis ball", "number": "4", "colour": "29,86,6:64,255,255"},
}
ANSWERED_CAMERA = {"camera": "/dev/video0", "calibration": "1 m"}


def answers(kind: str, *wishes: Wish, output: str = "") -> dict[str, str]:
    given = {**ANSWERED_CAMERA, **TARGETS[kind], "wish": " ".join(wish.key for wish in wishes)}
    seen_m = reliable_range_m(Known(folder=Path(), answers=given, frames=(FRAME,), camera_model=LENS))
    for wish in wishes:
        given |= {f"{wish.key}_{key}": ready for key, ready in ready_answers(wish, seen_m).items()}
        if wish.output:
            given |= {"base": {"base": "screen"}, "mqtt": {"broker": "127.0.0.1"}}.get(
                wish.output, {f"{wish.key}_output": output or wish.output}
            )
    return given


def loaded(folder: Path, given: dict[str, str]) -> Configuration:
    for name, text in configuration_files(given, LENS).items():
        (folder / name).write_text(text, encoding="utf-8")
    return load_configuration(folder / "stadimeter.toml")


def step_of(key: str, blank: str) -> BlankStep:
    wish = next(each for each in WISHES if each.key == key)
    return BlankStep(wish, next(each for each in wish.blanks if each.key == blank))


def known_of(given: dict[str, str]) -> Known:
    return Known(folder=Path(), answers=given, frames=(FRAME,), camera_model=LENS)


# What happens, rather than what is so.
HAPPENS = [wish for wish in WISHES if wish.output]
OF_ONE = [wish for wish in HAPPENS if not wish.needs_several]


@pytest.mark.parametrize(
    "wish", [OF_ONE[0], *(pytest.param(wish, marks=pytest.mark.long) for wish in OF_ONE[1:])], ids=lambda wish: wish.key
)
def test_every_wish_is_a_configuration_with_two_tests_that_pass(tmp_path: Path, wish: Wish) -> None:
    configuration = loaded(tmp_path, answers("ball", wish))
    warnings = [*configuration.warnings, *feasibility_warnings(configuration)]
    assert warnings == []
    assert len(configuration.tests) == 2
    results = [run_rule_test(configuration, test) for test in configuration.tests]
    assert [(each.test.name, each.failures, each.trouble) for each in results if not each.passed] == []


@pytest.mark.long
def test_a_wish_for_several_counts_them_and_its_tests_pass(tmp_path: Path) -> None:
    (crowd,) = (wish for wish in HAPPENS if wish.needs_several)
    configuration = loaded(tmp_path, answers("balls", crowd))
    assert [*configuration.warnings, *feasibility_warnings(configuration)] == []
    results = [run_rule_test(configuration, test) for test in configuration.tests]
    assert [each.failures for each in results] == [()] * 2
    with pytest.raises(ConfigError, match="crowd is for several of one kind"):
        WishStep().accept(known_of(TARGETS["ball"]), "crowd")


@each_case(
    "key, blank, wrong, words",
    [
        ("floor", "height", "1 deg", "unknown unit 'deg'"),
        ("water", "medium", "oil", "air, water, sea water"),
        ("water", "port", "1", "'1' has no unit"),
        ("stereo", "file", "nothing.toml", "stereo"),
        ("places", "tags", "3: 0 m, 2 m, 50 cm, 0 deg; 3: 1 m, 2 m, 50 cm, 0 deg", "tag 3 is listed twice"),
    ],
)
def test_what_cannot_be_so_is_refused_at_its_question(key: str, blank: str, wrong: str, words: str) -> None:
    given = {**ANSWERED_CAMERA, **TARGETS["ball"], "wish": f"near {key}"}
    with pytest.raises(ConfigError) as refused:
        step_of(key, blank).accept(known_of(given), wrong)
    assert words in str(refused.value)


@each_case(
    "key, blank, before, wrong, words",
    [
        ("often", "times", {}, "1", "'1' is no number from 2 to 999"),
        ("often", "window", {"often_times": "20"}, "1 min", "1 min is too short for 20 visits"),
        ("night", "end", {"night_begin": "22:00"}, "22:00", "22:00 is when it begins"),
        ("closer", "tag", TARGETS["tag"], "36h11 3, 8 cm", "is the target itself"),
        ("closer", "tag", {"slow_tag": "36h11 7, 8 cm"}, "36h11 7, 9 cm", "tag-7 is '36h11 7, 8 cm' already"),
        ("mute", "button", {"near_output": "buzzer 22"}, "22", "pin 22 is taken by 'buzzer 22'"),
        ("dark", "place", {}, "91, 13", "is no latitude and longitude"),
    ],
)
def test_what_is_no_answer_to_a_blank_is_refused_in_a_sentence(
    key: str, blank: str, before: dict[str, str], wrong: str, words: str
) -> None:
    given = {**ANSWERED_CAMERA, **TARGETS["ball"], "wish": f"{key} slow", **before}
    with pytest.raises(ConfigError, match=re.escape(words)):
        step_of(key, blank).accept(known_of(given), wrong)


def test_two_wishes_would_not_drive_one_robot() -> None:
    with pytest.raises(ConfigError, match="follow and permit would drive one robot"):
        WishStep().accept(known_of({}), "follow near permit")


def test_a_button_takes_its_pin_from_the_outputs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Computer, "is_pi", True)
    assert step_of("mute", "button").question(known_of({**ANSWERED_CAMERA, **TARGETS["ball"]})).ready == "22"
    near = next(each for each in WISHES if each.key == "near")
    with pytest.raises(ConfigError, match="pin 22 is taken by 'button 22'"):
        WishOutputStep(near).accept(known_of({"wish": "mute near", "mute_button": "22"}), "buzzer 22")


def test_all_wishes_but_those_for_further_robots_go_into_one_configuration(tmp_path: Path) -> None:
    wishes = [wish for wish in HAPPENS if wish.key not in {"permit", "slow"}]
    configuration = loaded(tmp_path, answers("balls", *wishes))
    assert len(configuration.tests) == 2 * len(wishes)
    assert {wish.group for wish in wishes} == {wish.group for wish in HAPPENS}
    words = describe(configuration)
    for clause in (" are raised within ", "sunset"):
        assert any(clause in sentence for sentence in words), clause


# The interview with pictures: a sheet that is not flat, pictures of two cameras, and which distance is meant.


def ball_before(near_side_m: float) -> Image:
    ball = BallTarget(position_m=(0.0, 0.0, near_side_m + 0.1), diameter_m=0.2)
    return render(Scene(camera=CAMERA, target=ball, seed=1, backdrop=PlainBackdrop())).image


def mixed(folder: Path, other: tuple[int, int]) -> None:
    cv2.imwrite(str(folder / "a.png"), ball_before(1.0))
    cv2.imwrite(str(folder / "b.png"), cv2.resize(ball_before(1.0), other))


@pytest.mark.parametrize(("other", "is_refused"), [((480, 640), True), ((320, 240), False)])
def test_check_names_the_picture_at_which_a_run_would_stop(tmp_path: Path, other, is_refused: bool) -> None:
    mixed(tmp_path, other)
    (tmp_path / "camera.toml").write_text(
        "width_px = 640\nheight_px = 480\nfx_px = 600\nfy_px = 600\ncx_px = 319.5\ncy_px = 239.5\n"
    )
    config = tmp_path / "stadimeter.toml"
    config.write_text(
        '[camera]\ndriver = "images"\npaths = "*.png"\nmodel = "camera.toml"\n'
        '[targets.ball]\ndetector = "ball"\ndiameter = "20 cm"\nhsv = "20,60,40:50,255,255"\n'
    )
    told = CliRunner().invoke(app, ["check", str(config)])
    assert ("b.png has 480x640 px" in told.output) == is_refused, told.output
