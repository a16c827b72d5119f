"""The commands ``check`` and ``schema``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from stadimeter.cli.main import app
from stadimeter.config.schema import configuration_schema

# The command `check` prints every error beside its line, or what the configuration does.


WRONG = """\
[camera]
driver = "opencvv"
model = { width_px = 640, height_px = 480, fx_px = 600.0, fy_px = 600.0, cx_px = 319.5, cy_px = 239.5 }
[targets.ball]
detector = "ball"
diameter = "0 cm"
hsv = "29,86,6:64,255,255"

[rules.near]
actuator = "motor"
when = { belwo = "50 cm" }  # a comment
"""


def run_check(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["check", *arguments])


@pytest.fixture
def wrong(tmp_path: Path) -> Path:
    file = tmp_path / "wrong.toml"
    file.write_text(WRONG, encoding="utf-8")
    return file


def test_errors_stand_beside_their_lines_underlined(wrong: Path) -> None:
    result = run_check(str(wrong))
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.splitlines() == [
        (
            f"{wrong}:2: error: camera.driver: no camera driver is called 'opencvv'; did you mean 'opencv'? "
            "There are: images, opencv, picamera2, simulated, video"
        ),
        '  2 | driver = "opencvv"',
        "    | ^^^^^^^^^^^^^^^^^^",
        f"{wrong}:6: error: targets.ball.diameter: '0 cm' is not a length above zero",
        '  6 | diameter = "0 cm"',
        "    | ^^^^^^^^^^^^^^^^^",
        f"{wrong}:10: error: rules.near.actuator: there is no actuator 'motor'",
        '  10 | actuator = "motor"',
        "     | ^^^^^^^^^^^^^^^^^^",
        "       add a section [actuators.motor]",
        f"{wrong}:11: error: rules.near.when.belwo: unknown key 'belwo'",
        '  11 | when = { belwo = "50 cm" }  # a comment',
        "     |          ^^^^^^^^^^^^^^^",
        "       did you mean 'below'?",
        f"4 errors: {wrong} cannot be used",
    ]


def test_a_file_that_is_not_there_is_one_clear_line(tmp_path: Path) -> None:
    result = run_check(str(tmp_path / "nowhere.toml"))
    assert result.exit_code == 2
    assert result.stderr.splitlines()[0] == f"{tmp_path / 'nowhere.toml'}: error: there is no such file"


SHADOWED = """\
[camera]
driver = "simulated"
model = { width_px = 640, height_px = 480, fx_px = 600.0 }
[world]
[messenger]
driver = "simulated"
[targets.ball]
detector = "ideal"

[actuators.lamp]
driver = "simulated"
[rules.near]
actuator = "lamp"
when = { below = "80 cm" }
[rules.far]
actuator = "lamp"
priority = 200
when = { below = "90 cm" }
"""


@pytest.fixture
def shadowed(tmp_path: Path) -> Path:
    file = tmp_path / "shadowed.toml"
    file.write_text(SHADOWED, encoding="utf-8")
    return file


def test_a_rule_that_never_wins_says_which_one_does_and_what_to_do(shadowed: Path) -> None:
    result = run_check(str(shadowed))
    assert result.stdout.splitlines()[:4] == [
        f"{shadowed}:12: warning: rules.near: wherever 'near' holds, 'far' holds too and wins 'lamp'",
        "  12 | [rules.near]",
        "     | ^^^^^^^^^^^^",
        "       give 'near' the higher priority, or let 'far' hold less often",
    ]


@pytest.mark.parametrize(("arguments", "code"), [((), 0), (("--strict",), 1), (("--strict", "--json"), 1)])
def test_a_warning_counts_only_if_that_is_wanted(shadowed: Path, arguments: tuple[str, ...], code: int) -> None:
    assert run_check(str(shadowed), *arguments).exit_code == code


# The command `schema` prints what editors complete from.


@pytest.mark.long
def test_the_schema_is_printed_and_nothing_else() -> None:
    result = CliRunner().invoke(app, ["check", "--schema"])
    assert result.exit_code == 0
    assert json.loads(result.stdout) == configuration_schema()
    assert result.stderr == ""
