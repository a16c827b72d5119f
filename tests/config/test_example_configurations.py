"""Every configuration that ships can be used as it is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from stadimeter.config.describe import describe
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.plugins import BASES, driver_names
from stadimeter.core.rule import AlarmRule, RampRule
from support.ready_bases import READY, follow_ball

FOLDER = Path(__file__).parents[2] / "config"
FILES = sorted(FOLDER.glob("*.toml"))


def test_the_four_uses_are_there() -> None:
    assert {file.stem for file in FILES} == {"appliance", "demo", "distance-alert", "follow-ball"}


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_it_loads_without_a_warning_but_that_pins_have_no_time_out(file: Path) -> None:
    loaded = load_configuration(file)
    assert {warning.code for warning in loaded.warnings} <= {"base-never-stops-by-itself"}
    assert not loaded.warnings or file.stem == "follow-ball"
    assert loaded.plan.rules
    assert len(describe(loaded)) > len(loaded.plan.rules)


def test_the_two_uses_that_people_ask_for_most_are_three_lines_each() -> None:
    text = (FOLDER / "distance-alert.toml").read_text(encoding="utf-8")
    far, near = load_configuration(FOLDER / "distance-alert.toml").plan.rules
    written = text[text.index("[rules.") : text.index("[[tests]]")]
    rules = [line for line in written.splitlines() if line and not line.startswith("#")]
    assert len(rules) == 6
    assert isinstance(far, RampRule)
    assert (far.output, far.start, far.full) == ("motor", pytest.approx(3.048), pytest.approx(6.096))
    assert isinstance(near, AlarmRule)
    assert near.output == "buzzer"


# The bases that the example of a robot has ready, each behind ``#``, beside the one that it uses.


@pytest.mark.parametrize("driver", READY)
def test_a_base_that_is_ready_takes_the_place_of_the_one_that_is_used(tmp_path: Path, driver: str) -> None:
    path = tmp_path / "follow.toml"
    path.write_text(follow_ball(driver), encoding="utf-8")
    base = load_configuration(path).base
    assert base is not None
    assert base.driver == driver


def test_the_example_has_every_base_ready_that_is_one_board() -> None:
    """A protocol of one's own has no usual lines, a bridge to ROS is another program's, and a servo drives nowhere."""
    others = {"simulated", "ascii", "pan-servo", *(name for name in driver_names(BASES) if name.startswith("ros2"))}
    assert set(READY) == set(driver_names(BASES)) - others


# A configuration says in plain sentences what it does, with the right figures.


Load = Callable[[str], Configuration]


def test_a_safe_level_that_is_not_off_is_told(load: Load, sound: str) -> None:
    text = sound.replace("pin = 18", "pin = 18\nsafe = 0.5")
    assert describe(load(f'{text}[rules.it]\nactuator = "motor"\nramp = {{ from = "1 m", to = "2 m" }}\n'))[
        -1
    ].endswith("; at 50% when lost.")


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("", "If lost, it holds for 5 s, then goes safe."),
        ("latch = true", "If lost, it holds."),
        ('lost = { policy = "clear" }', "If lost for 0.5 s, it clears 1 s later."),
        ('lost = { policy = "assert" }', "If lost for 0.5 s, it is raised: not seeing counts as danger."),
    ],
)
def test_what_an_alarm_does_without_its_target_is_told(load: Load, sound: str, keys: str, words: str) -> None:
    rule = f'[rules.it]\nactuator = "motor"\nwhen = {{ below = "1 m" }}\n{keys}\n'
    assert words in describe(load(sound + rule))[-1]


def test_the_rule_that_goes_before_others_says_so(load: Load, sound: str) -> None:
    rules = (
        '[rules.follow]\nactuator = "base"\nfollow = { distance = "1 m" }\n'
        '[rules.stop]\nactuator = "base"\npriority = 200\nwhen = { below = "40 cm" }\n'
    )
    *_, follow, stop = describe(load(sound + rules))
    assert "Goes before" not in follow
    assert stop.endswith(" Goes before `follow`.")
