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
from stadimeter.cameras.protocol import AttachedCamera
from stadimeter.cli.main import app
from stadimeter.config.describe import describe
from stadimeter.config.driver_tables import BASE
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame, Image
from stadimeter.errors import ConfigError
from stadimeter.workbench import frame_source
from stadimeter.workbench.doctor.checks import Computer
from stadimeter.workbench.rule_tests import run_rule_test
from stadimeter.workbench.setup.camera_step import table_of
from stadimeter.workbench.setup.interview import Interview, load_answers
from stadimeter.workbench.setup.question import Known
from stadimeter.workbench.setup.recipe_steps import (
    BaseStep,
    BlankStep,
    OutputStep,
    RecipeStep,
    base_table,
    configuration_files,
    recipe_steps,
)
from stadimeter.workbench.setup.recipes import Recipe, load_recipes
from stadimeter.workbench.setup.target import offered_kinds
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
def test_of_the_eight_answers_to_a_buzzer_six_are_asked(
    tmp_path: Path, device: V4l2Double, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = str(device.node)
    only = AttachedCamera(driver="opencv", options={"device": node}, path=node, name="webcam", node=node)
    monkeypatch.setattr(frame_source, "list_cameras", lambda: (only,))
    interview, asked = Interview(tmp_path), []
    given = {"target": "ball", "size": "20 cm", "calibration": "1 m"}
    while (question := interview.question()) is not None:
        asked += [] if question.is_sure else [question.key]
        interview.answer(given.get(question.key, question.ready))
    assert len(interview.known.answers) == 8
    assert len(asked) == 6, "the only camera, and a colour that nothing else has, are shown"
    assert {"camera", "colour"}.isdisjoint(asked)


@pytest.mark.long
def test_the_form_of_a_size_lists_names_where_its_target_knows_some() -> None:
    forms = {kind.key: {blank.key: blank.form for blank in kind.blanks} for kind in offered_kinds().values()}
    assert forms["ball"]["size"].endswith("football, basketball")
    assert forms["sheet"]["size"].endswith("A4 ± 3 mm")


def test_another_interview_goes_on_where_one_was_left(interview: Interview, tmp_path: Path) -> None:
    interview.answer("1 m")
    again = Interview(tmp_path)
    resumed = [key for key, _ in again.resume(load_answers(interview.path))]
    assert resumed == ["camera", "target", "size", "colour", "calibration"]
    assert again.next_key == "recipe"
    assert again.known.camera_model == interview.known.camera_model


def test_answers_may_be_numbers_and_lists_but_no_tables(tmp_path: Path) -> None:
    file = tmp_path / "answers.toml"
    file.write_text('camera = 0\ncalibration = ["a b.jpg@1m", "c.jpg@2m"]\n')
    assert load_answers(file) == {"camera": "0", "calibration": "'a b.jpg@1m' c.jpg@2m"}
    file.write_text("recipe = { near = true }\n")
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
        (
            "'my ball.jpg' b.png",
            {"driver": "images", "paths": ["my ball.jpg", "b.png"], "rate": "5 Hz", "dwell": "2 s", "loop": True},
        ),
    ]:
        assert table_of(answer) == table


@pytest.mark.parametrize("driver", ["gpio-motors", "pca9685", "ros-arduino-bridge"])
def test_each_base_is_set_up_by_its_ready_answers_alone(driver: str) -> None:
    known = known_of({**ANSWERED_CAMERA, **TARGETS["ball"], "recipe": "follow"})
    known.answers["base"] = BaseStep().accept(known, driver).answer
    for step in recipe_steps(known.answers):
        if step.key.startswith("base_"):
            question = step.question(known)
            assert len(question.text) > len(f"{step.key}: "), "its description is the question"
            known.answers[step.key] = step.accept(known, question.ready).answer
    choice = known.choose(BASE, ("base",), base_table(known.answers))
    assert choice.driver == driver
    assert {key.removeprefix("base_") for key in known.answers if key.startswith("base_")} < set(
        base_table(known.answers)
    )


# What `init` writes: every recipe gives a configuration without a warning whose tests pass.

FRAME = Frame(image=np.zeros((480, 640, 3), np.uint8), captured_at_s=0.0, sequence=0)
TARGETS = {
    "ball": {"target": "ball", "size": "tennis ball", "colour": "29,86,6:64,255,255"},
    "tag": {"target": "tag", "size": "10 cm", "tag": "36h11 7"},
    "balls": {"target": "balls", "size": "tennis ball", "number": "4", "colour": "29,86,6:64,255,255"},
}
ANSWERED_CAMERA = {"camera": "/dev/video0", "calibration": "1 m"}
RECIPES = load_recipes()


def known_of(given: dict[str, str]) -> Known:
    return Known(folder=Path("/nonexistent"), answers=given, frames=(FRAME,), camera_model=LENS)


def answered(kind: str, *recipes: str) -> Known:
    """Return what is known once every question has its ready answer, with outputs on their pins."""
    known = known_of({**ANSWERED_CAMERA, **TARGETS[kind]})
    known.answers["recipe"] = RecipeStep().accept(known, " ".join(recipes)).answer
    while left := [step for step in recipe_steps(known.answers) if step.key not in known.answers]:
        question = left[0].question(known)
        wired = next((each.answer for each in question.options if each.meaning.startswith("wired")), question.ready)
        known.answers[left[0].key] = left[0].accept(known, wired).answer
    return known


def loaded(known: Known) -> Configuration:
    files = configuration_files(known.answers, LENS)
    return load_configuration(known.file, texts={known.path(name): text for name, text in files.items()})


def step_of(key: str, blank: str) -> BlankStep:
    return BlankStep(RECIPES[key], next(each for each in RECIPES[key].blanks if each.key == blank))


# What happens, rather than what is so.
HAPPENS = [recipe for recipe in RECIPES.values() if recipe.output]
ONE, *OTHERS = HAPPENS


@pytest.mark.parametrize(
    "recipe", [ONE, *(pytest.param(each, marks=pytest.mark.long) for each in OTHERS)], ids=lambda recipe: recipe.key
)
def test_every_recipe_is_a_configuration_with_two_tests_that_pass(recipe: Recipe) -> None:
    configuration = loaded(answered("balls" if recipe.needs_several else "ball", recipe.key))
    assert [*configuration.warnings, *feasibility_warnings(configuration)] == []
    assert len(configuration.tests) == 2
    results = [run_rule_test(configuration, test) for test in configuration.tests]
    assert [(each.test.name, each.failures, each.trouble) for each in results if not each.passed] == []


LEAVES_THE_PICTURE = """
[[tests]]
name = "it leaves the picture twice while it is near"
[tests.input]
target = "ball"
clock = "10:00"
hover = { at = "50 cm", for = "30 s" }
lost = [{ from = "4 s", for = "6 s" }, { from = "14 s", for = "6 s" }]
[tests.expect]
KEY-near = { raised = 3 }
"""


@pytest.mark.parametrize("key", ["often", "daily", "visits", "total"])
def test_a_visit_ends_when_the_target_leaves_the_picture(key: str) -> None:
    known = answered("ball", key)
    files = {known.path(name): text for name, text in configuration_files(known.answers, LENS).items()}
    files[known.file] += LEAVES_THE_PICTURE.replace("KEY", key)
    configuration = load_configuration(known.file, texts=files)
    result = run_rule_test(configuration, configuration.tests[-1])
    assert (result.trouble, result.failures) == ("", ())


@each_case(
    "key, blank, before, wrong, words",
    [
        ("often", "times", {}, "1", "'1' is no number from 2 to 999"),
        ("often", "window", {"often_times": "20"}, "1 min", "1 min is not more than 62 s"),
        ("far", "to", {"far_from": "2 m"}, "1 m", "1 m is not more than 2 m"),
        ("night", "end", {"night_begin": "22:00"}, "22:00", "the time ends when it begins"),
        ("mute", "button", {"mute_output": "buzzer 22"}, "gpio 22", "22"),
        ("dark", "north", {}, "91", "90"),
        ("floor", "height", {}, "1 deg", "unknown unit 'deg'"),
        ("water", "medium", {}, "oil", "air, water, sea water"),
        ("water", "port", {}, "1", "'1' has no unit"),
        ("stereo", "file", {}, "nothing.toml", "stereo"),
        (
            "places",
            "tags",
            {},
            ", ".join(2 * [RECIPES["places"].blanks[1].ready.partition(", { ")[0]]),
            "3 is listed twice",
        ),
    ],
)
def test_what_is_no_answer_to_a_blank_is_refused_in_a_sentence(
    key: str, blank: str, before: dict[str, str], wrong: str, words: str
) -> None:
    recipe = key if RECIPES[key].output else f"near {key}"
    given = {**ANSWERED_CAMERA, **TARGETS["ball"], "recipe": recipe, **before}
    with pytest.raises(ConfigError, match=re.escape(words)):
        step_of(key, blank).accept(known_of(given), wrong)


def test_a_second_tag_is_another_than_the_target() -> None:
    step, known = step_of("closer", "number"), known_of({**ANSWERED_CAMERA, **TARGETS["tag"], "recipe": "closer"})
    assert step.question(known).ready == "8"
    with pytest.raises(ConfigError, match="'7' is the target itself"):
        step.accept(known, "7")


def test_a_button_is_on_a_pin_of_a_pi_and_an_output_leaves_it_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    assert step_of("mute", "button").question(known_of({**ANSWERED_CAMERA, **TARGETS["ball"]})).ready == "screen"
    monkeypatch.setattr(Computer, "is_pi", True)
    assert step_of("mute", "button").question(known_of({**ANSWERED_CAMERA, **TARGETS["ball"]})).ready == "gpio 22"
    given = {**ANSWERED_CAMERA, **TARGETS["ball"], "recipe": "mute near", "mute_button": "gpio 22"}
    with pytest.raises(ConfigError, match="22"):
        OutputStep(RECIPES["near"]).accept(known_of(given), "buzzer 22")


def test_all_recipes_but_those_for_further_robots_go_into_one_configuration() -> None:
    recipes = [recipe for recipe in HAPPENS if recipe.key not in {"permit", "slow"}]
    configuration = loaded(answered("balls", *(recipe.key for recipe in recipes)))
    assert len(configuration.tests) == 2 * len(recipes)
    assert {recipe.group for recipe in recipes} == {recipe.group for recipe in HAPPENS}
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
