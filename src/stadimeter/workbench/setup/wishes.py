"""What shall happen: rules with blanks, each with two tests of what it promises.

In a template, ``{near}`` stands for the answer to the blank ``near``, ``{near:3}`` for three times as much, and
``{near:1/s}`` for a speed of as much in a second. ``{target}`` is the target's name, and ``{drives}`` the line that
names the output.
"""

from __future__ import annotations

from dataclasses import dataclass

from stadimeter.config.units import DURATIONS_S, LENGTHS_M, SPEEDS_MPS, parse_length, parse_quantity


@dataclass(frozen=True, slots=True, kw_only=True)
class Blank:
    """A figure that a wish leaves open; its units are those of the ready answer."""

    key: str
    text: str
    ready: str

    @property
    def is_length(self) -> bool:
        """Whether it is a distance."""
        return _is_of(self.ready, LENGTHS_M)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """Something that people want to happen.

    Attributes:
        output: The ready answer to what it drives; ``base`` for a robot, empty for messages only.
        rules: The rules and their tests, a template.
        targets: The kinds of targets that it makes sense for; empty for all.
    """

    key: str
    title: str
    blanks: tuple[Blank, ...]
    output: str
    rules: str
    targets: tuple[str, ...] = ()


WITHIN_REACH = 0.8
"""Ready distances are within this share of how far away the target is found reliably: hysteresis needs the rest."""


class Figure:
    """A figure with a unit, for templates."""

    def __init__(self, text: str) -> None:
        self._text = " ".join(text.split())

    def __format__(self, form: str) -> str:
        """Return the figure as it was written, times a number, or as a speed."""
        if not form:
            return self._text
        units = next(each for each in (LENGTHS_M, DURATIONS_S, SPEEDS_MPS) if _is_of(self._text, each))
        factor, is_speed, _ = form.partition("/s")
        unit = {id(LENGTHS_M): "m", id(DURATIONS_S): "s", id(SPEEDS_MPS): "m/s"}[id(units)]
        value = float(factor) * parse_quantity(self._text, units, "")
        return f"{value:.4g} {unit}{'/s' if is_speed else ''}"


def figure_si(text: str, blank: Blank) -> float:
    """Return a figure in SI units; a ValueError unless it is above zero, in units such as those of the ready answer."""
    units = next(each for each in (LENGTHS_M, DURATIONS_S, SPEEDS_MPS) if _is_of(blank.ready, each))
    value = parse_quantity(text, units, blank.ready)
    if value <= 0:
        raise ValueError(f"{text!r} is not above zero; write it such as {blank.ready!r}")
    return value


def ready_answers(wish: Wish, seen_up_to_m: float) -> dict[str, str]:
    """Return the ready answers to the blanks, nearer where the camera would not see that far."""
    lengths = [parse_length(blank.ready) for blank in wish.blanks if blank.is_length]
    nearer = min(1.0, WITHIN_REACH * seen_up_to_m / max(lengths, default=1.0))
    return {
        blank.key: f"{nearer * parse_length(blank.ready):.2g} m" if nearer < 1 and blank.is_length else blank.ready
        for blank in wish.blanks
    }


def _is_of(text: str, units: dict[str, float]) -> bool:
    try:
        parse_quantity(text, units, "")
    except ValueError:
        return False
    return True


_NEAR = Blank(key="near", text="Nearer than what?", ready="50 cm")

WISHES = (
    Wish(
        key="near",
        title="beep when it is near",
        blanks=(_NEAR,),
        output="buzzer 23",
        rules="""\
# Acts when it is nearer than {near}.
[rules.near]
{drives}when = {{ below = "{near}" }}

[[tests]]
name = "near: it acts at once when the {target} comes"
input = {{ target = "{target}", approach = {{ from = "{near:3}", to = "{near:0.5}", speed = "{near:1/s}" }} }}
expect.near = {{ raised = 1, raised_within = "0.3 s" }}

[[tests]]
name = "near: it does not chatter at {near}"
input = {{ target = "{target}", hover = {{ at = "{near}", for = "30 s" }} }}
expect.near = {{ transitions_max = 2 }}
""",
    ),
    Wish(
        key="far",
        title="vibrate when it is far, stronger the further it gets",
        blanks=(
            Blank(key="from", text="From which distance on?", ready="2 m"),
            Blank(key="to", text="And fully from where?", ready="4 m"),
        ),
        output="vibration-motor 18",
        rules="""\
# Acts from {from} on, and fully from {to} on.
[rules.far]
{drives}ramp = {{ from = "{from}", to = "{to}" }}

[[tests]]
name = "far: fully on when the {target} is far, off when it is near"
input.target = "{target}"
input.points = [
  {{ at = "0 s", distance = "{to:1.4}" }},
  {{ at = "2 s", distance = "{to:1.4}" }},
  {{ at = "5 s", distance = "{from:0.5}" }},
  {{ at = "8 s", distance = "{from:0.5}" }},
]
expect.{output} = {{ level_at = {{ at = "1.5 s", min = 0.9 }}, stopped_at = {{ from = "6.5 s", for = "1 s" }} }}

[[tests]]
name = "far: off while the {target} is out of sight"
input = {{ target = "{target}", hover = {{ at = "{to:1.2}", for = "6 s" }}, lost = [{{ from = "2 s", for = "2 s" }}] }}
expect.{output} = {{ acts_at = ["2 s", "6 s"], stopped_at = {{ from = "2.8 s", for = "1 s" }} }}
""",
    ),
    Wish(
        key="follow",
        title="a robot follows it, and stops when it cannot see it",
        blanks=(
            Blank(key="keep", text="Which distance shall it keep?", ready="1 m"),
            Blank(key="speed", text="How fast at most?", ready="0.3 m/s"),
        ),
        output="base",
        rules="""\
# Keeps {keep} away from it.
[rules.follow]
actuator = "base"
target = "{target}"
follow = {{ distance = "{keep}", max_speed = "{speed}" }}

# Whatever the rule above wants: stands still when it is nearer than {keep:0.4}. The higher priority wins.
[rules.stop]
actuator = "base"
target = "{target}"
severity = "safety"
priority = 200
when = {{ below = "{keep:0.4}" }}

[[tests]]
name = "follow: the robot stops when the {target} rushes at it"
input = {{ target = "{target}", approach = {{ from = "{keep:3}", to = "{keep:0.2}", speed = "{keep:1/s}" }} }}
expect.stop = {{ raised = 1 }}
expect.base = {{ acts_at = "1 s", speed_max = "{speed}", stopped_at = {{ from = "3.9 s", for = "0.7 s" }} }}

[[tests]]
name = "follow: the robot stands still when it does not see the {target}"
input = {{ target = "{target}", hover = {{ at = "{keep:3}", for = "6 s" }}, lost = [{{ from = "2 s", for = "2 s" }}] }}
expect.base = {{ acts_at = ["2 s", "6 s"], stopped_at = {{ from = "2.5 s", for = "1.5 s" }} }}
""",
    ),
    Wish(
        key="mqtt",
        title="alerts over MQTT, for Home Assistant, Node-RED and others",
        blanks=(_NEAR,),
        output="mqtt",
        rules="""\
# Sends an alarm when it is nearer than {near}, and another message when it is gone.
[rules.too-close]
target = "{target}"
severity = "alarm"
when = {{ below = "{near}" }}
off_delay = "2 s"

[rules.gone]
target = "{target}"
when = {{ lost_for = "5 s" }}

[[tests]]
name = "mqtt: coming and going is one alarm"
input.target = "{target}"
input.points = [
  {{ at = "0 s", distance = "{near:3}" }},
  {{ at = "3 s", distance = "{near:0.5}" }},
  {{ at = "6 s", distance = "{near:3}" }},
  {{ at = "10 s", distance = "{near:3}" }},
]
expect.too-close = {{ raised = 1, cleared = 1 }}

[[tests]]
name = "mqtt: behind something for a moment is not gone"
input = {{ target = "{target}", hover = {{ at = "{near:2}", for = "12 s" }}, lost = [{{ from = "2 s", for = "3 s" }}] }}
expect.gone = {{ raised = 0 }}
""",
    ),
    Wish(
        key="parking",
        title="parking zones: slow beeps, fast beeps, then one long tone",
        blanks=(
            Blank(key="slow", text="Slow beeps within which distance?", ready="1.5 m"),
            Blank(key="stop", text="And the long tone, within which distance?", ready="50 cm"),
        ),
        output="buzzer 23",
        rules="""\
# Slow beeps within {slow}, fast ones half way from there, and one long tone within {stop}. The nearest zone wins.
[rules.slow-beeps]
{drives}priority = 101
when = {{ below = "{slow}" }}
pattern = {{ on = "0.2 s", off = "0.6 s" }}

[rules.fast-beeps]
{drives}priority = 102
when = {{ below = "{middle}" }}
pattern = {{ on = "0.1 s", off = "0.15 s" }}

[rules.stop-here]
{drives}priority = 103
when = {{ below = "{stop}" }}

[[tests]]
name = "parking: each zone once, in order"
input = {{ target = "{target}", approach = {{ from = "{slow:2}", to = "{stop:0.6}", speed = "{stop:1/s}" }} }}
expect.slow-beeps = {{ raised = 1, cleared = 0 }}
expect.fast-beeps = {{ raised = 1, cleared = 0 }}
expect.stop-here = {{ raised = 1, cleared = 0 }}

[[tests]]
name = "parking: silence beyond the zones"
input = {{ target = "{target}", hover = {{ at = "{slow:1.3}", for = "10 s" }} }}
expect.slow-beeps = {{ raised = 0 }}
""",
    ),
    Wish(
        key="gone",
        title="act when it is gone for five minutes",
        blanks=(Blank(key="time", text="Gone for how long?", ready="5 min"),),
        output="led 17",
        rules="""\
# Acts when it was out of sight for {time} without a break.
[rules.gone]
{drives}when = {{ lost_for = "{time}" }}

[[tests]]
name = "gone: the {target} that stays away is noticed"
[tests.input]
target = "{target}"
rate = "5 Hz"
hover = {{ at = "1 m", for = "{time:1.5}" }}
lost = [{{ from = "{time:0.1}", for = "{time:1.3}" }}]
[tests.expect.gone]
raised = 1
raised_after = "{time:1.09}"

[[tests]]
name = "gone: a shorter absence is nothing"
[tests.input]
target = "{target}"
rate = "5 Hz"
hover = {{ at = "1 m", for = "{time:1.5}" }}
lost = [{{ from = "{time:0.1}", for = "{time:0.8}" }}]
[tests.expect.gone]
raised = 0
""",
    ),
    Wish(
        key="latched",
        title="an alarm that stays until a person acknowledges it",
        blanks=(_NEAR,),
        output="buzzer 23",
        rules="""\
# Acts when it was nearer than {near}, until `stadimeter alarm ack latched`.
[rules.latched]
{drives}when = {{ below = "{near}" }}
latch = "until-acknowledged"

[[tests]]
name = "latched: it stays although the {target} has gone back"
input.target = "{target}"
input.points = [
  {{ at = "0 s", distance = "{near:3}" }},
  {{ at = "3 s", distance = "{near:0.5}" }},
  {{ at = "6 s", distance = "{near:3}" }},
  {{ at = "12 s", distance = "{near:3}" }},
]
expect.latched = {{ raised = 1, cleared = 0, active_at = "12 s" }}

[[tests]]
name = "latched: acknowledged, it is over"
input.target = "{target}"
input.points = [
  {{ at = "0 s", distance = "{near:3}" }},
  {{ at = "3 s", distance = "{near:0.5}" }},
  {{ at = "6 s", distance = "{near:3}" }},
  {{ at = "14 s", distance = "{near:3}" }},
]
input.operator = [{{ at = "10 s", acknowledge = "latched" }}]
expect.latched = {{ raised = 1, cleared = 1, inactive_at = "13 s" }}
""",
    ),
    Wish(
        key="light",
        title="light while something is near, and 30 s after",
        blanks=(
            Blank(key="near", text="Nearer than what?", ready="2 m"),
            Blank(key="after", text="How long after that?", ready="30 s"),
        ),
        output="relay 27",
        rules="""\
# On while it is nearer than {near}, and {after} longer, also when it just leaves the picture.
[rules.light]
{drives}when = {{ below = "{near}" }}
off_delay = "{after}"

[[tests]]
name = "light: it stays on for {after}"
[tests.input]
target = "{target}"
rate = "10 Hz"
skip = {{ from = "{near:0.5}", to = "{near:1.5}", wait = "5 s", stay = "{after:2}" }}
[tests.expect.light]
raised = 1
cleared = 1
cleared_after = "{after}"

[[tests]]
name = "light: it goes off after the {target} has left the picture"
[tests.input]
target = "{target}"
rate = "10 Hz"
hover = {{ at = "{near:0.5}", for = "{after:3}" }}
lost = [{{ from = "{after:0.5}", for = "{after:2.5}" }}]
[tests.expect.light]
raised = 1
cleared = 1
""",
    ),
    Wish(
        key="apart",
        title="act when two targets are too close to each other",
        blanks=(Blank(key="apart", text="Nearer to each other than what?", ready="50 cm"),),
        output="buzzer 23",
        targets=("ball", "tag"),
        rules="""\
# Acts when the two are nearer to each other than {apart}.
[rules.apart]
{drives}when = {{ separation = {{ of = ["{target}", "{target}-2"], below = "{apart}" }} }}

[[tests]]
name = "apart: side by side they are too close"
[tests.input.targets.{target}]
hover = {{ at = "{apart:2}", for = "8 s" }}
[tests.input.targets.{target}-2]
hover = {{ at = "{apart:2.2}", for = "8 s" }}
[tests.expect.apart]
raised = 1

[[tests]]
name = "apart: one far behind the other is not"
[tests.input.targets.{target}]
hover = {{ at = "{apart:2}", for = "8 s" }}
[tests.input.targets.{target}-2]
hover = {{ at = "{apart:5}", for = "8 s" }}
[tests.expect.apart]
raised = 0
""",
    ),
)
