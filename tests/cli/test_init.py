"""`init`: from an installed program to measured targets of one's own with a rule that acts, with one command."""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest

from stadimeter.config.camera_file import save_camera_model
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.workbench.saving import versions
from stadimeter.workbench.setup.interview import save_answers
from support.command_line import Typed, typed
from support.scenes.backdrop import PlainBackdrop
from support.scenes.ball import BallTarget
from support.scenes.cut_sheet import GroupTarget
from support.scenes.plane import DiscTarget, Pose, SheetTarget, TagTarget
from support.scenes.render import render
from support.scenes.scene import Scene
from support.terminal import Terminal

pytestmark = [pytest.mark.vision, pytest.mark.timeout(300)]


# `init`: from an installed program to a measured target of one's own with a rule that acts, with one command.

LENS = CameraModel.with_focal_length(600.0, 640, 480)
TARGETS: dict[str, Callable[[float], object]] = {
    "ball": lambda at_m: BallTarget(position_m=(0.0, 0.0, at_m), diameter_m=0.2),
    "sheet": lambda at_m: SheetTarget(pose=_facing(at_m), width_m=0.297, height_m=0.21),
    "tag": lambda at_m: TagTarget(pose=_facing(at_m), side_m=0.2, family="apriltag-36h11", number=7),
    "disc": lambda at_m: DiscTarget(pose=_facing(at_m), diameter_m=0.2),
}
SIZES = {"ball": "20 cm", "sheet": "A4", "tag": "20 cm", "disc": "20 cm"}


def _facing(at_m: float) -> Pose:
    return Pose(position_m=(0.0, 0.0, at_m), tilt_rad=0.0)


def _picture(path: Path, kind: str, at_m: float) -> None:
    scene = Scene(camera=LENS, target=TARGETS[kind](at_m), seed=1, backdrop=PlainBackdrop())
    cv2.imwrite(str(path), render(scene).image)


def _init(folder: Path, **answers: str) -> Typed:
    file = folder / "given.toml"
    file.write_text("".join(f"{key} = '''{answer}'''\n" for key, answer in answers.items()), encoding="utf-8")
    return typed("init", folder, "--answers", file)


def _distances(output: str) -> list[float]:
    return [float(each) for each in re.findall(r"([\d.]+) m ±", output)]


@pytest.mark.long
@pytest.mark.parametrize("kind", ["ball", "tag"])
def test_one_command_leads_to_a_measured_target_and_a_rule_that_acts(tmp_path: Path, kind: str) -> None:
    for at_m in (0.8, 2.0):
        _picture(tmp_path / f"{at_m:g}m.png", kind, at_m)
    camera = "0.8m.png 0.8m.png 0.8m.png 0.8m.png 2m.png"
    told = _init(tmp_path, camera=camera, target=kind, size=SIZES[kind], near_near="1 m")
    assert told.returncode == 0, told
    assert "2 tests: 2 passed" in told.stdout
    assert len(tomllib.loads((tmp_path / "init-answers.toml").read_text())) <= 12
    measured = typed("measure", tmp_path / "2m.png", "--config", tmp_path / "stadimeter.toml")
    assert _distances(measured.stdout)[0] == pytest.approx(2.0, rel=0.01)
    ran = typed(
        "run", tmp_path / "stadimeter.toml", "--no-state", "--speed", "0", "--seconds", "20"
    )  # they go on for ever
    assert "near raised" in ran.stdout, "the first pictures show it at 0.8 m"


def test_a_target_far_from_the_middle_is_noted(tmp_path: Path) -> None:
    ball = BallTarget(position_m=(0.6, 0.0, 1.5), diameter_m=0.2)
    scene = Scene(camera=LENS, target=ball, seed=1, backdrop=PlainBackdrop())
    cv2.imwrite(str(tmp_path / "aside.png"), render(scene).image)
    told = _init(tmp_path, camera="aside.png", target="ball", size="20 cm", calibration="aside.png@1.5m")
    assert "aside.png: the target is 22° from the middle of the picture; 1.5 m was taken as its depth" in told.stdout


@pytest.mark.long
def test_what_was_there_is_kept_as_a_version(tmp_path: Path) -> None:
    _picture(tmp_path / "1m.png", "disc", 1.0)
    (tmp_path / "stadimeter.toml").write_text("# mine\n")
    for near in ("40 cm", "60 cm"):
        assert _init(tmp_path, target="disc", size="20 cm", near_near=near).returncode == 0
    newest, oldest = versions(tmp_path / "stadimeter.toml")
    assert (oldest.folder / "stadimeter.toml").read_text() == "# mine\n"
    assert '"40 cm"' in (newest.folder / "stadimeter.toml").read_text()


@pytest.mark.parametrize(
    ("answers", "words"),
    [
        ({"targt": "ball"}, "there is no such question (did you mean 'target'?)"),
        ({"target": "disc", "size": "20 m"}, "did you mean millimetres or inches?"),
        ({"target": "disc", "size": "20 cm", "near_output": "buzzer 99"}, "not a pin"),
        ({"camera": "no-such.png"}, "no-such.png"),
        ({"camera": "simulated", "colour": "green"}, "'green' is no picture. Point at the ball instead"),
        ({"target": "ball", "size": "20 cm", "colour": "3000,3"}, "is not in init/camera.png"),
        ({"target": "people", "number": "4", "model": "nowhere.onnx"}, "there is no file "),
    ],
)
def test_a_wrong_answer_is_named_with_its_question(tmp_path: Path, answers: dict[str, str], words: str) -> None:
    _picture(tmp_path / "1m.png", "disc", 1.0)
    told = _init(tmp_path, **answers)
    assert told.returncode == 2
    assert words in told.stderr
    assert f"given.toml: {list(answers)[-1]}: " in told.stderr
    assert not (tmp_path / "stadimeter.toml").exists()


def test_without_a_terminal_and_answers_it_says_how_to_give_them(tmp_path: Path) -> None:
    told = typed("init", tmp_path / "new")
    assert told.returncode == 2
    assert "--answers FILE" in told.stderr
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("name", ["follow-ball", "demo"])
def test_an_example_is_written_without_a_checkout(tmp_path: Path, name: str) -> None:
    assert typed("init", tmp_path, "--example", name).returncode == 0
    assert load_configuration(tmp_path / f"{name}.toml").plan.rules


def test_an_example_takes_the_place_of_no_pipe_and_reads_none(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "follow-ball.toml")
    told = typed("init", tmp_path, "--example", "follow-ball")
    assert (told.returncode, "it is no regular file, and is left alone" in told.stderr) == (2, True)
    assert os.listdir(tmp_path) == ["follow-ball.toml"]  # noqa: PTH208


@pytest.mark.long
def test_pictures_named_by_their_distances_lead_to_two_outputs_with_their_wiring(tmp_path: Path) -> None:
    for name, at_m in (("50cm", 0.6), ("2m", 2.1)):
        _picture(tmp_path / f"{name}.png", "ball", at_m)
    answers = {
        "camera": "50cm.png 2m.png",
        "target": "ball",
        "size": "20 cm",
        "calibration": "50cm.png@60cm 2m.png@2.1m",
        "recipe": "near light",
        "near_near": "40 cm",
        "near_output": "buzzer 23",
        "light_near": "2 m",
        "light_output": "led 17",
    }
    told = _init(tmp_path, **answers)
    assert told.returncode == 0, told
    assert (tmp_path / "init" / "wiring.svg").exists()


@pytest.mark.long
def test_the_next_commands_that_the_guide_names_work_in_the_simulated_room(tmp_path: Path) -> None:
    config = tmp_path / "stadimeter.toml"
    told = _init(tmp_path, camera="simulated", calibration="1 m")
    assert told.returncode == 0, told
    for command in ("measure --live", "run", "explain near"):
        assert f"stadimeter {command}" in told.stdout
    with closing(Terminal("measure", "--live", config, "--config", config)) as terminal:
        terminal.wait_for("±")
        interrupt(terminal)
        terminal.ended()
    journal = tmp_path / "run.jsonl"
    ran = typed("run", config, "--no-state", "--speed", "0", "--seconds", "5", "--journal", journal)
    assert ran.returncode == 0, ran
    assert "near" in typed("explain", "near", "--journal", journal).stdout


def test_a_folder_that_is_a_file_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "taken").touch()
    (tmp_path / "answers.toml").write_text('camera = "ball.png"\n')
    told = typed("init", tmp_path / "taken", "--answers", tmp_path / "answers.toml")
    assert told.returncode == 2
    assert told.stderr.count("\n") == 1
    assert "the folder cannot be made" in told.stderr


def interrupt(terminal: Terminal) -> None:
    """Type Ctrl-C until there is an answer: Python misses one that comes just before it waits for a line."""
    for _ in range(3):
        terminal.press("\x03")
        terminal.wait_for("^C")
        if terminal.program.poll() is not None or terminal.look(20.0):
            return


@pytest.mark.long
@pytest.mark.timeout(180)
def test_it_is_left_with_ctrl_c_and_taken_up_again_in_a_narrow_terminal(tmp_path: Path) -> None:
    _picture(tmp_path / "1m.png", "disc", 1.0)
    with closing(Terminal("init", columns=40, folder=tmp_path)) as first:
        for asked, answer in (("camera?", "\n"), ("measured?", "4\n"), ("How large", "20\n"), ("no unit", "20 cm\n")):
            first.wait_for(asked)
            first.wait_for("> ")
            first.press(answer)
        first.wait_for("How far away")
        first.wait_for("> ")
        interrupt(first)
        assert first.ended() == 1
        assert "Every answer is saved" in " ".join(first.shown.split())
    with closing(Terminal("init", folder=tmp_path)) as second:
        assert "Going on with the answers" in second.wait_for("How far away")
        for asked in ("> ", "happen?", "Nearer than", "drive?"):
            second.wait_for(asked)
            if asked != "> ":
                second.wait_for("> ")
            second.press("\n")
        assert second.ended() == 0
    assert load_configuration(tmp_path / "stadimeter.toml").plan.rules


# `init` for what a network finds, pictures, several of one kind, and what is known of floor, water and places.

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


@pytest.mark.long
def test_several_balls_are_set_up_counted_and_measured_each_by_its_name(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "three.png"), balls(NEAR, BESIDE, FAR))
    told = init(
        tmp_path, target="balls", size="20 cm", number="4", colour=COLOUR, recipe="near crowd", crowd_near="3 m"
    )
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
    run = ("run", tmp_path / "stadimeter.toml", "--no-state", "--speed", "0", "--seconds", "3")
    ran = typed(*run, "--record", tmp_path / "run.mcap")
    assert "crowd raised" in ran.stdout
    # Nobody searches for the nearest: it is one of them.
    assert "no frame was searched for" not in typed("replay", tmp_path / "run.mcap").stderr
