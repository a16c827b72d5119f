"""Several bases in one file, of which one line chooses."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import jsonschema
import pytest

from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.plugins import BASES, driver_names
from stadimeter.config.schema import configuration_schema
from stadimeter.errors import ConfigError

FOLLOW_BALL = (Path(__file__).parents[2] / "config" / "follow-ball.toml").read_text(encoding="utf-8")
READY = re.findall(r"^\[base\.([\w-]+)\]", FOLLOW_BALL, re.MULTILINE)
CHOSEN = 'driver = "gpio-motors"'


def load(folder: Path, text: str) -> Configuration:
    path = folder / "follow.toml"
    path.write_text(text, encoding="utf-8")
    return load_configuration(path)


def refused(folder: Path, text: str) -> list[tuple[str, int | None]]:
    with pytest.raises(ConfigError) as error:
        load(folder, text)
    return [(problem.key, problem.line) for problem in error.value.problems]


def line_of(text: str, words: str) -> int:
    return text[: text.index(words)].count("\n") + 1


@pytest.fixture(scope="module")
def schema() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(configuration_schema())


@pytest.mark.long
@pytest.mark.parametrize("driver", READY)
def test_one_line_of_the_example_chooses_the_base(
    tmp_path: Path, driver: str, schema: jsonschema.Draft202012Validator
) -> None:
    text = FOLLOW_BALL.replace(CHOSEN, f'driver = "{driver}"')
    base = load(tmp_path, text).base
    assert base is not None
    assert base.driver == driver
    assert set(tomllib.loads(text)["base"][driver]) <= base.options.model_fields_set
    schema.validate(tomllib.loads(text))


def test_the_example_has_every_base_ready_that_is_one_board() -> None:
    """A protocol of one's own has no usual table, a bridge to ROS is another program's, and a servo drives nowhere."""
    others = {"simulated", "ascii", "pan-servo", *(name for name in driver_names(BASES) if name.startswith("ros2"))}
    assert set(READY) == set(driver_names(BASES)) - others


def test_what_is_wrong_in_the_chosen_table_is_found_at_its_line(tmp_path: Path) -> None:
    text = FOLLOW_BALL.replace("pwm = 13", "pwm = 12")
    assert refused(tmp_path, text) == [("base.right.pwm", line_of(text, "right = "))]
    text = FOLLOW_BALL.replace("forward = 17", "forward = 99")
    assert refused(tmp_path, text)[0] == ("base.left.forward", line_of(text, "left = "))


def test_a_table_that_is_not_chosen_is_checked_too(tmp_path: Path) -> None:
    text = FOLLOW_BALL.replace("ticks_per_turn = 1440", "ticks_per_turn = -1")
    at = line_of(text, "ticks_per_turn = -1")
    assert refused(tmp_path, text) == [("base.ros-arduino-bridge.ticks_per_turn", at)]


def test_pins_of_a_base_that_is_not_chosen_are_free(tmp_path: Path) -> None:
    lamp = '[actuators.lamp]\ndriver = "led"\npin = 17\n'
    text = FOLLOW_BALL + lamp
    assert len(refused(tmp_path, text)) == 1
    load(tmp_path, text.replace(CHOSEN, 'driver = "pca9685"'))


def test_a_table_of_no_driver_is_an_unknown_key(tmp_path: Path) -> None:
    text = FOLLOW_BALL.replace("[base.pca9685]", "[base.pca9865]")
    assert ("base.pca9865", line_of(text, "[base.pca9865]")) in refused(tmp_path, text)
