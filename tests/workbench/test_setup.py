"""The interview before a live camera, a double of a device that shows rendered balls."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from stadimeter.config.camera_file import save_camera_model
from stadimeter.config.driver_tables import BASE
from stadimeter.config.loader import load_configuration
from stadimeter.config.units import parse_length, split_spread
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.errors import CalibrationError, ConfigError
from stadimeter.workbench.setup.camera_step import table_of
from stadimeter.workbench.setup.files import base_table, configuration_files
from stadimeter.workbench.setup.interview import Interview, load_answers, save_answers
from stadimeter.workbench.setup.question import Known
from stadimeter.workbench.setup.wish_steps import BaseStep, option_steps
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.v4l2_double import V4l2Double

pytestmark = pytest.mark.vision

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
def test_a_ball_before_a_camera_takes_nine_answers(interview: Interview, device: V4l2Double) -> None:
    interview.answer("1 m")
    device.show(ball_at(3.0))
    question = interview.question()
    assert question is not None
    assert (question.key, question.ready) == ("proof", "3 m")
    assert "The two distances agree." in interview.answer("3 m").notes
    while (question := interview.question()) is not None:
        interview.answer(question.ready)
    known = interview.known
    assert len(known.answers) == 9
    assert known.camera_model is not None
    assert known.camera_model.fx_px == pytest.approx(600.0, rel=0.01)
    for name, text in configuration_files(known.answers, known.camera_model).items():
        (known.folder / name).write_text(text, encoding="utf-8")
    assert load_configuration(known.file).camera.options.device == str(device.node)


@pytest.mark.long
def test_a_second_distance_that_contradicts_the_first_is_refused(interview: Interview, device: V4l2Double) -> None:
    interview.answer("1 m")
    device.show(ball_at(2.0))
    with pytest.raises(CalibrationError, match="contradict each other"):
        interview.answer("3 m")
    assert interview.next_key == "proof"
    interview.answer("2 m")
    assert interview.next_key == "wish"


@pytest.mark.long
def test_a_size_that_is_not_known_is_learnt_by_moving_the_camera(tmp_path: Path, device: V4l2Double) -> None:
    save_camera_model(tmp_path / "camera.toml", LENS)
    begun = Interview(tmp_path)
    for answer in (_camera(device), "ball", "I don't know", COLOUR):
        begun.answer(answer)
    question = begun.question()
    assert "How was the camera calibrated?" in question.text
    assert question.ready == "camera.toml"
    with pytest.raises(ConfigError, match="without a size a distance calibrates nothing"):
        begun.answer("1 m")
    begun.answer("camera.toml")
    for key, moved_m in (("way", 0.0), ("way_2", 0.2), ("way_3", 0.4)):
        device.show(ball_at(1.5 - moved_m))
        question = begun.question()
        assert question.key == key
        accepted = begun.answer(question.ready)
    assert begun.next_key == "wish"
    size_m, tolerance_m = map(parse_length, split_spread(begun.known.answers["size"]))
    assert accepted.notes == (f"The ball measures {begun.known.answers['size']}.",)
    assert size_m == pytest.approx(BALL_M, abs=2 * tolerance_m)
    assert 0.01 < tolerance_m / size_m < 0.1
    again = Interview(tmp_path)
    resumed = dict(again.resume(load_answers(begun.path)))
    assert again.next_key == "wish"
    assert "size" in resumed
    begun.back()
    assert begun.next_key == "way_3", "the way is asked again, though the size is known meanwhile"


@pytest.mark.long
def test_another_interview_goes_on_where_one_was_left(interview: Interview, tmp_path: Path) -> None:
    interview.answer("1 m")
    again = Interview(tmp_path)
    resumed = [key for key, _ in again.resume(load_answers(interview.path))]
    assert resumed == ["camera", "target", "size", "colour", "calibration"]
    assert again.next_key == "proof"
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
