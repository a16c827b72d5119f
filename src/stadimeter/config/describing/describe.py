"""Says in plain sentences what a configuration does, with the figures it works out to."""

from __future__ import annotations

import math
from collections.abc import Iterator

from stadimeter.config.describing.alarms import consequences, rhythm
from stadimeter.config.describing.conditions import begins, ends, needs_figures
from stadimeter.config.describing.ramps import strength
from stadimeter.config.loader import Configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.plan import BaseOutput
from stadimeter.core.rule import AlarmRule, AnyRule, FollowRule, LostPolicy, OnDelay, RampRule
from stadimeter.core.words import length

_VERBS = {"vibration-motor": "vibrates", "buzzer": "buzzes", "led": "lights", "relay": "switches on"}
"""What an actuator does when it acts, by its driver."""

NAMED_MAX = 10
"""Of more rules than these, the rest are counted: nobody reads a list of hundreds."""


def describe(configuration: Configuration) -> tuple[str, ...]:
    """Say what a configuration does.

    Args:
        configuration: The configuration.

    Returns:
        One sentence or two for what it looks through and for each rule, in the order of the file. Names of parts
        stand between backticks.
    """
    return (*_parts(configuration), *(_rule(rule, configuration) for rule in configuration.plan.rules))


def _parts(configuration: Configuration) -> Iterator[str]:
    lens = f" through a lens of {_lens(configuration.camera_model)}" if configuration.camera_model else ""
    targets = " and ".join(f"`{target.name}` ({target.driver})" for target in configuration.targets)
    yield f"Looks for {targets} with the camera driver {configuration.camera.driver}{lens}."
    if configuration.messenger:
        yield f"Sends messages with {configuration.messenger.driver}."
    for notifier in configuration.notifiers:
        yield f"Tells people through `{notifier.name}` ({notifier.driver})."


def _lens(model: CameraModel) -> str:
    width_deg = math.degrees(2 * math.atan(model.width_px / 2 / model.fx_px))
    return f"{model.fx_px:.0f} px focal length, {width_deg:.0f}° wide at {model.width_px}x{model.height_px}"


def _rule(rule: AnyRule, configuration: Configuration) -> str:
    match rule:
        case AlarmRule():
            return f"`{rule.name}` {_alarm(rule, configuration)}"
        case RampRule():
            return f"`{rule.name}` {_ramp(rule, configuration)}"
        case _:
            return f"`{rule.name}` {_follow(rule, configuration)}"


def _alarm(rule: AlarmRule, configuration: Configuration) -> str:
    condition = f"{_acts(rule, configuration)} when {begins(rule.condition)}{_delay(rule.on_delay)}"
    besides = consequences(rule, lambda output: _verb_of(output, configuration))
    return f"{condition}; clears {_ends(rule)}.{_lost_alarm(rule)}{besides}{_wins(rule, configuration)}"


def _acts(rule: AlarmRule, configuration: Configuration) -> str:
    if rule.output is None:
        return f"gives the alert ({rule.severity})"
    verb = _verb_of(rule.output, configuration)
    if verb == "stops":
        return f"stops `{rule.output}`"
    level = "" if rule.level == 1 or rule.pattern is not None else f" at {rule.level:.0%}"
    return f"{verb} `{rule.output}`{level}{rhythm(rule.pattern)}"


def _verb_of(output: str, configuration: Configuration) -> str:
    if any(isinstance(each, BaseOutput) and each.name == output for each in configuration.plan.outputs):
        return "stops"
    return _verb(output, configuration)


def _verb(output: str, configuration: Configuration) -> str:
    driver = next((each.driver for each in configuration.actuators if each.name == output), "")
    return _VERBS.get(driver, "drives")


def _delay(delay: OnDelay) -> str:
    if delay.frames:
        return f" in {delay.frames} of {delay.of_frames} frames"
    return f" for {delay.hold_s:g} s" if delay.hold_s else ""


def _ends(rule: AlarmRule) -> str:
    held = f"for {rule.off_delay_s:g} s" if rule.off_delay_s else "at once"
    return f"when {ends(rule.condition)} {held}"


def _lost_alarm(rule: AlarmRule) -> str:
    lost = rule.lost
    given_up = f", and goes to the safe state after {lost.fault_after_s:g} s" if rule.output else ""
    if not needs_figures(rule.condition):
        return ""
    match lost.policy:
        case LostPolicy.HOLD:
            return f" When lost: stays as it was{given_up}."
        case LostPolicy.CLEAR:
            return f" When lost for {lost.grace_s:g} s: clears."
        case _:
            return f" When lost for {lost.grace_s:g} s: raised, since not seeing counts as danger."


def _wins(rule: AnyRule, configuration: Configuration) -> str:
    rivals = (each for each in configuration.plan.rules if each.output == rule.output is not None)
    losers = [f"`{each.name}`" for each in rivals if each.priority < rule.priority]
    if len(losers) > NAMED_MAX:
        losers[NAMED_MAX:] = [f"{len(losers) - NAMED_MAX} other rules"]
    return f" Goes before {' and '.join(losers)}." if losers else ""


def _ramp(rule: RampRule, configuration: Configuration) -> str:
    output = rule.output or ""
    return (
        f"{_verb(output, configuration)} `{output}` {strength(rule)}; {_safe(output, configuration)} when lost."
        f"{_wins(rule, configuration)}"
    )


def _safe(output: str, configuration: Configuration) -> str:
    level = next(
        (
            each.safe_level
            for each in configuration.plan.outputs
            if each.name == output and not isinstance(each, BaseOutput)
        ),
        0.0,
    )
    return f"at {level:.0%}" if level else "off"


def _follow(rule: FollowRule, configuration: Configuration) -> str:
    base = next((each for each in configuration.plan.outputs if isinstance(each, BaseOutput)), None)
    most_mps = min(rule.linear_max_mps, base.linear_max_mps) if base else rule.linear_max_mps
    reverse = f"up to {rule.reverse_max_mps:g} m/s backwards" if rule.reverse_max_mps else "never backwards"
    return (
        f"keeps `{rule.output}` {length(rule.distance_m)} from `{rule.target}` and turned towards it, "
        f"up to {most_mps:g} m/s forwards, {reverse}; stops when lost."
        f"{_wins(rule, configuration)}"
    )
