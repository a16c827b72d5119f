"""The status LED and the buttons in a configuration: what is read, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.app.service import write_safe_outputs
from stadimeter.config.describe import describe
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.errors import ConfigError
from support.simulated_run import SIMULATED_BALL

RULES = """
[world]

[rules.near]
actuator = "motor"
when = { below = "2 m" }
shelve_max = "1 h"

[rules.touching]
actuator = "motor"
severity = "safety"
when = { below = "20 cm" }
off_delay = "1 s"

[rules.far]
actuator = "motor"
ramp = { from = "3 m", to = "6 m" }
"""
LED = '[status_led]\ndriver = "led"\npin = 17\n'


def load(folder: Path, *parts: str) -> Configuration:
    path = folder / "run.toml"
    path.write_text("\n".join((SIMULATED_BALL, RULES, *parts)))
    return load_configuration(path)


def button(*keys: str, driver: str = "gpio", pin: int = 27) -> str:
    where = f"pin = {pin}" if driver == "gpio" else ""
    return "\n".join(("[buttons.front]", f'driver = "{driver}"', where, *keys))


def problems(folder: Path, *parts: str) -> list[tuple[str, str]]:
    with pytest.raises(ConfigError) as caught:
        load(folder, *parts)
    return [(problem.code, problem.key) for problem in caught.value.problems]


def test_the_panel_is_read_and_described(tmp_path: Path) -> None:
    keys = ('press = "put-back"', 'hold = "shelve"', 'hold_for = "3 s"', 'shelve_for = "30 min"', 'rule = "near"')
    configuration = load(tmp_path, LED, button(*keys))
    assert configuration.status_led is not None
    assert configuration.status_led.options.pin == 17
    table = configuration.button_tables["front"]
    assert (table.press, table.hold, table.hold_for, table.shelve_for) == ("put-back", "shelve", 3.0, 1800.0)
    told = " ".join(describe(configuration))
    assert "Shows how it is doing on `status_led` (led)." in told
    assert "The button `front` is for `near`; pressed: put-back; held for 3 s: shelve." in told


def test_a_button_without_more_acknowledges(tmp_path: Path) -> None:
    assert "The button `front` is for all; pressed: acknowledge." in describe(load(tmp_path, button()))


@pytest.mark.parametrize(
    ("keys", "found"),
    [
        (('press = "armed"',), [("bad-value", "buttons.front.press")]),
        (('hold_for = "3 s"',), [("bad-value", "buttons.front")]),
        (('hold = "shelve"', 'hold_for = "0.9 s"'), [("bad-value", "buttons.front.hold_for")]),
        (('hold = "shelve"', 'hold_for = "6 s"'), [("bad-value", "buttons.front.hold_for")]),
        (('shelve_for = "1 h"',), [("bad-value", "buttons.front")]),
        (('rule = "nere"',), [("unknown-name", "buttons.front.rule")]),
        (("pull_up = false",), [("unknown-key", "buttons.front.pull_up")]),
    ],
)
def test_a_button_that_cannot_mean_what_it_says_is_refused(
    tmp_path: Path, keys: tuple[str, ...], found: list[tuple[str, str]]
) -> None:
    assert problems(tmp_path, button(*keys)) == found


def test_a_pin_that_the_pi_itself_uses_is_warned_of(tmp_path: Path) -> None:
    found = [(each.code, each.key) for each in load(tmp_path, button(pin=3)).warnings if each.code == "pin-taken"]
    assert found == [("pin-taken", "buttons.front.pin")]


def test_the_light_is_switched_off_when_the_program_is_gone_and_no_button_is_driven(tmp_path: Path) -> None:
    lines = tmp_path / "safe-outputs.conf"
    assert write_safe_outputs(load(tmp_path, LED, button()), lines) == []
    assert lines.read_text() == "pin 17 low\n"
