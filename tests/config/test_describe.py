"""A configuration says in plain sentences what it does, with the right figures."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from stadimeter.config.describe import describe
from stadimeter.config.loader import Configuration

Load = Callable[[str], Configuration]


def test_what_it_looks_for_and_through_is_told_first(load: Load, sound: str) -> None:
    assert describe(load(sound + '[messenger]\ndriver = "simulated"\n')) == (
        (
            "Looks for `ball` (ball) with the camera driver opencv through a lens of 600 px "
            "focal length, 56° wide at 640x480."
        ),
        "Sends messages with simulated.",
    )


@pytest.mark.parametrize(
    ("rule", "sentence"),
    [
        (
            'actuator = "motor"\nramp = { from = "10 ft", to = "20 ft" }',
            (
                "`it` vibrates `motor` when `ball` is further than 3.05 m (10.0 ft), full at "
                "6.10 m (20.0 ft); off when lost."
            ),
        ),
        (
            'actuator = "buzzer"\nwhen = { below = "50 cm" }',
            (
                "`it` buzzes `buzzer` when `ball` is nearer than 0.50 m (1.6 ft) with a "
                "probability of 70%; "
                "clears when it is further than 0.50 m (1.6 ft) by 3 standard deviations of the noise for 1 s. "
                "When lost: stays as it was, and goes to the safe state after 5 s."
            ),
        ),
        (
            (
                'actuator = "buzzer"\nwhen = { between = ["1 m", "2 m"], deadband = "10 cm", deadband_sigmas = 0, '
                'probability = "none" }\non_delay = "2 s"\noff_delay = "0 s"\nlevel = 0.5\n'
                'lost = { policy = "clear", grace = "1 s" }'
            ),
            (
                "`it` buzzes `buzzer` at 50% when `ball` is between 1.00 m (3.3 ft) and 2.00 m (6.6 ft) for 2 s; "
                "clears when it is nearer than 0.90 m (3.0 ft) or further than 2.10 m (6.9 ft) at once. "
                "When lost for 1 s: clears."
            ),
        ),
        (
            'severity = "alarm"\nwhen = { lost = true }\non_delay = "5 s"',
            ("`it` gives the alert (alarm) when `ball` is out of sight for 5 s; clears when that has ended for 1 s."),
        ),
        (
            'actuator = "base"\nfollow = { distance = "1 m", max_speed = "9 m/s", max_reverse_speed = "0.1 m/s" }',
            (
                "`it` keeps `base` 1.00 m (3.3 ft) from `ball` and turned towards it, up to 0.5 "
                "m/s forwards, up to 0.1 m/s "
                "backwards; stops when lost, then turns in steps to look for it, for 20 s at most."
            ),
        ),
        (
            'actuator = "base"\nfollow = { distance = "1 m", search = "off", tether = "5 m" }',
            (
                "`it` keeps `base` 1.00 m (3.3 ft) from `ball` and turned towards it, up to 0.3 m/s forwards, never "
                "backwards, no further than 5.00 m (16.4 ft) from where it began; stops when lost."
            ),
        ),
    ],
)
def test_a_rule_is_told_in_words(load: Load, sound: str, rule: str, sentence: str) -> None:
    assert describe(load(f"{sound}[rules.it]\n{rule}\n"))[-1] == sentence


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


def test_of_many_rules_that_one_goes_before_the_first_are_named_and_the_rest_counted(load: Load, sound: str) -> None:
    rules = "".join(
        f'[rules.low-{n}]\nactuator = "base"\npriority = {n}\nwhen = {{ below = "{40 + n} cm" }}\n' for n in range(13)
    )
    *_, stop = describe(
        load(sound + rules + '[rules.stop]\nactuator = "base"\npriority = 200\nwhen = { below = "3 m" }\n')
    )
    assert stop.endswith("`low-8` and `low-9` and 3 other rules.")
