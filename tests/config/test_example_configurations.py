"""Every configuration that ships can be used as it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.config.describe import describe
from stadimeter.config.loader import load_configuration
from stadimeter.core.rule import AlarmRule, RampRule

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
