"""What `init` writes: every wish gives a configuration without a warning whose tests pass."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame
from stadimeter.errors import ConfigError
from stadimeter.workbench.rule_tests.running import run_rule_test
from stadimeter.workbench.setup.files import WISHES, Wish, configuration_files, ready_answers
from stadimeter.workbench.setup.question import Known
from stadimeter.workbench.setup.wish_steps import BlankStep, reliable_range_m

LENS = CameraModel.with_focal_length(600.0, 640, 480)
FRAME = Frame(image=np.zeros((480, 640, 3), np.uint8), captured_at_s=0.0, sequence=0)
TARGETS = {
    "ball": {"target": "ball", "size": "tennis ball", "colour": "29,86,6:64,255,255"},
    "sheet": {"target": "sheet", "size": "letter"},
    "tag": {"target": "tag", "size": "10 cm", "tag": "36h11 3"},
    "disc": {"target": "disc", "size": "12 cm"},
}
CAMERA = {"camera": "/dev/video0", "calibration": "1 m"}


def answers(kind: str, *wishes: Wish, output: str = "") -> dict[str, str]:
    given = {**CAMERA, **TARGETS[kind], "wish": " ".join(wish.key for wish in wishes)}
    seen_m = reliable_range_m(Known(folder=Path(), answers=given, frames=(FRAME,), camera_model=LENS))
    for wish in wishes:
        given |= {f"{wish.key}_{key}": ready for key, ready in ready_answers(wish, seen_m).items()}
        given |= {"base": {"base": "screen"}, "mqtt": {"broker": "127.0.0.1"}}.get(
            wish.output, {f"{wish.key}_output": output or wish.output}
        )
    return given


def loaded(folder: Path, given: dict[str, str]) -> Configuration:
    for name, text in configuration_files(given, LENS).items():
        (folder / name).write_text(text, encoding="utf-8")
    return load_configuration(folder / "stadimeter.toml")


@pytest.mark.parametrize("kind", TARGETS)
@pytest.mark.parametrize("wish", WISHES, ids=lambda wish: wish.key)
def test_every_wish_is_a_configuration_with_two_tests_that_pass(tmp_path: Path, wish: Wish, kind: str) -> None:
    configuration = loaded(tmp_path, answers(kind, wish))
    warnings = [*configuration.warnings, *feasibility_warnings(configuration)]
    assert warnings == []
    assert len(configuration.tests) == 2
    results = [run_rule_test(configuration, test) for test in configuration.tests]
    assert [(each.test.name, each.failures, each.trouble) for each in results if not each.passed] == []


def test_a_distance_that_turns_the_sentence_around_is_refused() -> None:
    for key, blank, before, wrong, words in [
        ("far", "to", {"far_from": "10 ft"}, "5 ft", "5 ft is not farther than 10 ft"),
        ("far", "to", {"far_from": "2 m"}, "200 cm", "200 cm is not farther than 2 m"),
        ("parking", "stop", {"parking_slow": "1 m"}, "1.5 m", "1.5 m is not nearer than 1 m"),
    ]:
        wish = next(each for each in WISHES if each.key == key)
        step = BlankStep(wish, next(each for each in wish.blanks if each.key == blank))
        known = Known(
            folder=Path(), answers={**CAMERA, **TARGETS["ball"], **before}, frames=(FRAME,), camera_model=LENS
        )
        with pytest.raises(ConfigError, match=words):
            step.accept(known, wrong)


def test_several_wishes_share_an_output_on_one_pin(tmp_path: Path) -> None:
    near, parking = (wish for wish in WISHES if wish.key in {"near", "parking"})
    configuration = loaded(tmp_path, answers("disc", near, parking))
    assert [each.name for each in configuration.actuators] == ["buzzer"]
    results = [run_rule_test(configuration, test) for test in configuration.tests]
    assert [each.test.name for each in results if not each.passed] == []
