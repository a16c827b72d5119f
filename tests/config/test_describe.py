"""A configuration says in plain sentences what it does, with the right figures."""

from __future__ import annotations

from collections.abc import Callable

from stadimeter.config.describe import describe
from stadimeter.config.loader import Configuration

Load = Callable[[str], Configuration]


def test_a_safe_level_that_is_not_off_is_told(load: Load, sound: str) -> None:
    text = sound.replace("pin = 18", "pin = 18\nsafe = 0.5")
    assert describe(load(f'{text}[rules.it]\nactuator = "motor"\nramp = {{ from = "1 m", to = "2 m" }}\n'))[
        -1
    ].endswith("; at 50% when lost.")


def test_the_rule_that_goes_before_others_says_so(load: Load, sound: str) -> None:
    rules = (
        '[rules.follow]\nactuator = "base"\nfollow = { distance = "1 m" }\n'
        '[rules.stop]\nactuator = "base"\npriority = 200\nwhen = { below = "40 cm" }\n'
    )
    *_, follow, stop = describe(load(sound + rules))
    assert "Goes before" not in follow
    assert stop.endswith(" Goes before `follow`.")
