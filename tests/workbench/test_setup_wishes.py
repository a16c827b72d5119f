"""What `init` writes: every wish gives a configuration without a warning whose tests pass."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.config.describe import describe
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame
from stadimeter.errors import ConfigError
from stadimeter.workbench.doctor.computer import Computer
from stadimeter.workbench.rule_tests.running import run_rule_test
from stadimeter.workbench.setup.files import WISHES, Wish, configuration_files, ready_answers
from stadimeter.workbench.setup.question import Known
from stadimeter.workbench.setup.wish_steps import BlankStep, WishOutputStep, WishStep, reliable_range_m
from support.each_case import each_case

LENS = CameraModel.with_focal_length(600.0, 640, 480)
FRAME = Frame(image=np.zeros((480, 640, 3), np.uint8), captured_at_s=0.0, sequence=0)
TARGETS = {
    "ball": {"target": "ball", "size": "tennis ball", "colour": "29,86,6:64,255,255"},
    "tag": {"target": "tag", "size": "10 cm", "tag": "36h11 3"},
    "balls": {"target": "balls", "size": "tennis ball", "number": "4", "colour": "29,86,6:64,255,255"},
}
CAMERA = {"camera": "/dev/video0", "calibration": "1 m"}


def answers(kind: str, *wishes: Wish, output: str = "") -> dict[str, str]:
    given = {**CAMERA, **TARGETS[kind], "wish": " ".join(wish.key for wish in wishes)}
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
    given = {**CAMERA, **TARGETS["ball"], "wish": f"near {key}"}
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
    given = {**CAMERA, **TARGETS["ball"], "wish": f"{key} slow", **before}
    with pytest.raises(ConfigError, match=re.escape(words)):
        step_of(key, blank).accept(known_of(given), wrong)


def test_two_wishes_would_not_drive_one_robot() -> None:
    with pytest.raises(ConfigError, match="follow and permit would drive one robot"):
        WishStep().accept(known_of({}), "follow near permit")


def test_a_button_takes_its_pin_from_the_outputs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Computer, "is_pi", True)
    assert step_of("mute", "button").question(known_of({**CAMERA, **TARGETS["ball"]})).ready == "22"
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
