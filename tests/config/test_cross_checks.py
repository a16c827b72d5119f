"""What is fine by itself and wrong together is found; what only looks alike is not."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import ClassVar

import pytest

from stadimeter.config import plugins
from stadimeter.config.describe import describe
from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import DriverOptions, OptionsTable
from stadimeter.config.units import Pin, SerialPort
from stadimeter.errors import Problem

Load = Callable[[str], Configuration]
Problems = Callable[[str], tuple[Problem, ...]]
Told = Callable[[str], list[str]]

NEAR = '[rules.near]\nactuator = "buzzer"\n'


BROKEN = [
    ('[rules.near]\nactuator = "buzzer"\ntarget = "bal"\nwhen = { below = "1 m" }',
     "rules.near.target: there is no target 'bal' (did you mean 'ball'?)"),
    ('[rules.near]\nactuator = "zzz"\nwhen = { below = "1 m" }',
     "rules.near.actuator: there is no actuator 'zzz' (known are: base, buzzer, motor)"),
    (f'{NEAR}every = "1 min"\nramp = {{ from = "1 m", to = "2 m" }}',
     "rules.near: a rule has one of ramp, follow, every, at, or when alone; make"),
    (NEAR, "rules.near: the rule does nothing (write one of ramp, follow, every, at, or when alone, such as"),
    (f'{NEAR}ramp = {{ from = "1 m", to = "2 m" }}\nlevel = 0.5', "rules.near: 'level' has no meaning beside"),
    (f"{NEAR}when = {{ }}", "rules.near.when: the condition is empty; write one of above, below, between, seen,"),
    (f'{NEAR}when = {{ above = "2 m", below = "1 m" }}', "rules.near.when: nothing is between these limits"),
    (f'{NEAR}when = {{ between = ["2 m", "2 m"] }}', "rules.near.when: nothing is between these limits"),
    (f'{NEAR}when = {{ above = "1 m", deadband = "1 m" }}', "rules.near.when: with a deadband of 1 m above"),
    (f'{NEAR}when = {{ below = "1 m", probability_off = 0.9 }}', "probability_off 0.9 is above probability 0.7"),
    (f'{NEAR}when = {{ below = "1 m" }}\non_delay = {{ frames = 5, of = 3 }}', "rules.near.on_delay: 5 of 3 frames"),
    (f'{NEAR}when = {{ below = "1 m" }}\nlost = {{ grace = "2 s", fault_after = "1 s" }}', "is shorter than grace 2 s"),
    (f'{NEAR}ramp = {{ from = "1 m", to = "2 m", min = 0.8, max = 0.2 }}', "rules.near.ramp: min 0.8 is above max"),
    ('[rules.near]\nramp = { from = "1 m", to = "2 m" }', "rules.near.actuator: a ramp needs an actuator to drive"),
    ('[rules.near]\nactuator = "base"\nramp = { from = "1 m", to = "2 m" }', "and cannot drive the base"),
    (f'{NEAR}follow = {{ distance = "1 m" }}', "rules.near.actuator: only the base can follow"),
    ('[rules.near]\nfollow = { distance = "1 m" }', "only the base can follow"),
    ('[rules.near]\nactuator = "base"\nfollow = { distance = "1 m", deadband = "2 m" }', "reaches past the distance"),
    ('[rules.near]\nactuator = "base"\nfollow = { distance = "1 m", turn_deadband = "-1 deg" }', "is below zero"),
    ("[rules.safety]\nwhen = { seen = true }", "rules.safety: 'safety' cannot be a name here"),
]  # fmt: skip


@pytest.mark.long
def test_a_rule_that_cannot_work_is_refused(told: Told, sound: str, subtests: pytest.Subtests) -> None:
    for rules, words in BROKEN:
        with subtests.test(rules=rules):
            (line,) = told(f"{sound}{rules}\n")
            assert words in line


WORKING = [
    f'{NEAR}when = {{ above = "1 m", below = "2 m" }}',
    f'{NEAR}when = {{ above = "1 m", deadband = "99 cm" }}',
    f'{NEAR}when = {{ below = "1 m", deadband = "5 m" }}',
    f'{NEAR}when = {{ below = "1 m", probability = 0.5, probability_off = 0.5 }}',
    f'{NEAR}when = {{ below = "1 m", probability = "none" }}',
    f'{NEAR}when = {{ below = "1 m" }}\non_delay = {{ frames = 3, of = 3 }}\nlevel = 0.5',
    f'{NEAR}ramp = {{ from = "2 m", to = "1 m", min = 0.5, max = 0.5 }}',
    f'{NEAR}when = {{ seen = true }}\n[rules.too]\nactuator = "motor"\nwhen = {{ seen = true }}',
    f'{NEAR}when = {{ below = "1 m" }}\n[rules.too]\nactuator = "buzzer"\nwhen = {{ above = "2 m" }}',
    f'{NEAR}when = {{ seen = true }}\n[rules.too]\nactuator = "buzzer"\npriority = 101\nwhen = {{ seen = true }}',
    '[rules.stop]\nactuator = "base"\nwhen = { below = "40 cm" }',
    '[rules.stop]\nactuator = "base"\ntarget = "ball"\nfollow = { distance = "1 m", max_turn_rate = "0 deg/s" }',
]


def test_a_rule_that_works_is_accepted(load: Load, sound: str, subtests: pytest.Subtests) -> None:
    for rules in WORKING:
        with subtests.test(rules=rules):
            assert load(f"{sound}{rules}\n").plan.rules


def test_with_two_targets_a_rule_says_which(told: Told, load: Load, sound: str) -> None:
    second = '[targets.sheet]\ndetector = "ball"\ndiameter = "20 cm"\nhsv = "0,80,80:10,255,255"\n'
    assert told(f"{sound}{second}{NEAR}when = {{ seen = true }}\n") == [
        "rules.near.target: which of the targets ball, sheet is 'near' about? (add target = \"ball\")"
    ]
    (rule,) = load(f'{sound}{second}{NEAR}target = "sheet"\nwhen = {{ seen = true }}\n').plan.rules
    assert rule.target == "sheet"


def test_a_base_that_is_not_there_cannot_be_driven(told: Told, sound: str) -> None:
    without = sound[: sound.index("[base]")]
    assert told(f'{without}[rules.follow]\nactuator = "base"\nfollow = {{ distance = "1 m" }}\n') == [
        "rules.follow.actuator: there is no actuator 'base' (add a section [base])"
    ]


def test_a_port_and_a_pin_belong_to_one_driver_each(told: Told, sound: str, monkeypatch: pytest.MonkeyPatch) -> None:
    install_winch(monkeypatch)
    winch = '[actuators.winch]\ndriver = "test-winch"\nbrake = {}\nline = {{ port = "/dev/ttyUSB{}" }}\n'
    (port,), (pin,) = (told(sound + winch.format(*taken)) for taken in ((2, 0), (18, 1)))
    assert port.startswith("base.port: serial port /dev/ttyUSB0 is used twice: by actuators.winch.line.port and by ")
    assert pin.startswith("actuators.winch.brake: pin 18 is used twice: by actuators.motor.pin and by ")


def test_rules_need_a_camera_model(told: Told, load: Load, sound: str) -> None:
    head, _, rest = sound.partition("[camera.model]")
    without = head + rest[rest.index("[targets.ball]") :]
    assert load(without).camera_model is None
    (line,) = told(f"{without}{NEAR}when = {{ seen = true }}\n")
    assert line.startswith("camera.model: rules need distances, and distances need a camera model")


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('driver = "opencv"\ndevice = 0', 'driver = "simulated"', "camera.driver"),
        ('"ball"\ndiameter = "6.4 cm"\nhsv = "29,86,6:64,255,255"', '"ideal"', "targets.ball.detector"),
    ],
)
def test_what_is_simulated_needs_a_world(told: Told, load: Load, sound: str, old: str, new: str, key: str) -> None:
    text = sound.replace(old, new)
    (line,) = told(text)
    assert line.startswith(f"{key}: ")
    assert "needs a simulated world to be in, and there is no section [world] (add one; it may be empty)" in line
    assert load(text + "[world]\n").world is not None


def warnings(loaded: Configuration) -> list[str]:
    return [str(each).split(": ", 1)[1] for each in loaded.warnings]


USED = '[rules.a]\nactuator = "motor"\nramp = { from = "1 m", to = "2 m" }\n[rules.c]\nactuator = "base"\n'
QUIET = f'{USED}follow = {{ distance = "1 m" }}\n[rules.b]\nactuator = "buzzer"\nwhen = {{ below = "50 cm" }}\n'


LAMP = '[actuators.lamp]\ndriver = "led"\npin = 5\n'
LEASED = f'{LAMP}lease = "100 ms"\n[rules.d]\nactuator = "lamp"\nwhen = {{ seen = true }}\n'
HARDLY_MEANT = [
    (f"{QUIET}[rules.d]\nwhen = {{ lost = true }}\n", "rules.d: nothing reports the alert 'd': it drives nothing, and"),
    (QUIET + LAMP, "actuators.lamp: no rule uses 'lamp' (name it in a rule, or leave it out)"),
    (QUIET + LEASED, "actuators.lamp.lease: the lease 0.1 s is shorter than max_frame_age: it stops on frames"),
    ("", "rules: there is no rule, so nothing is ever done (add one, such as [rules.near])"),
]


def test_what_is_hardly_meant_gets_a_warning(load: Load, sound: str, subtests: pytest.Subtests) -> None:
    for text, words in HARDLY_MEANT:
        with subtests.test(text=text):
            (line,) = warnings(load(sound + text))
            assert line.startswith(words)


class Line(OptionsTable):
    """A table of its own inside a driver's options."""

    port: SerialPort


class WinchOptions(DriverOptions):
    """What no driver of ours has: a port in a table of its own, and a pin that may be left out."""

    verb: ClassVar = "winds"

    line: Line
    brake: Pin | None = None


class ModelOptions(DriverOptions):
    needs_world: ClassVar = True


def install_winch(monkeypatch: pytest.MonkeyPatch) -> None:
    entries = [
        EntryPoint(name="test-winch", value=f"{__name__}:WinchOptions", group=plugins.ACTUATORS),
        EntryPoint(name="test-model", value=f"{__name__}:ModelOptions", group=plugins.ACTUATORS),
    ]

    def with_winch(group: str) -> list[EntryPoint]:
        extra = entries if group == plugins.ACTUATORS else []
        return [*entry_points(group=group), *extra]

    monkeypatch.setattr(plugins, "installed", with_winch)


PULLING = """\
[actuators.winch]
driver = "test-winch"
line = { port = "/dev/ttyUSB9" }
[rules.near]
actuator = "winch"
when = { below = "1 m" }
"""


def test_a_driver_of_others_says_itself_what_checks_and_descriptions_need(
    load: Load, problems_of: Problems, sound: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    install_winch(monkeypatch)
    (missing,) = problems_of(f'{sound}[actuators.model]\ndriver = "test-model"\n')
    assert (missing.code, missing.key) == ("world-missing", "actuators.model.driver")
    configuration = load(sound + PULLING)
    assert any("`near` winds `winch`" in sentence for sentence in describe(configuration))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[tracking]\ncoast = "1 h"', "tracking.coast: 3600 s is longer than outputs may act without seeing, 1 s"),
        (
            '[safety]\nmax_frame_age = "2 s"',
            "safety.max_frame_age: 2 s is longer than outputs may act without seeing, 1 s",
        ),
    ],
)
def test_nothing_may_act_for_long_on_what_nobody_sees(told: Told, sound: str, text: str, words: str) -> None:
    assert [said.partition(" (")[0] for said in told(sound + text)] == [words]
