"""Says in plain sentences what a configuration does, with the figures it works out to."""

from __future__ import annotations

import math
from collections.abc import Iterator

from stadimeter.config.loader import Configuration
from stadimeter.config.units import FOOT_M
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.plan import (
    AlarmRule,
    AnyRule,
    BaseOutput,
    Condition,
    DistanceCondition,
    FollowRule,
    LostPolicy,
    OnDelay,
    PresenceCondition,
    RampRule,
)

_VERBS = {"vibration-motor": "vibrates", "buzzer": "buzzes", "led": "lights", "relay": "switches on"}
"""What an actuator does when it acts, by its driver."""


def describe(configuration: Configuration) -> tuple[str, ...]:
    """Say what a configuration does.

    Args:
        configuration: The configuration.

    Returns:
        One sentence or two for what it looks through and for each rule, in the order of the file. Names of parts
        stand between backticks.
    """
    return (*_parts(configuration), *(_rule(rule, configuration) for rule in configuration.plan.rules))


def length(metres: float) -> str:
    """Write a length in metres and in feet.

    Args:
        metres: The length.

    Returns:
        Such as ``3.05 m (10.0 ft)``.
    """
    return f"{metres:.2f} m ({metres / FOOT_M:.1f} ft)"


def _parts(configuration: Configuration) -> Iterator[str]:
    lens = f" through a lens of {_lens(configuration.camera_model)}" if configuration.camera_model else ""
    targets = " and ".join(f"`{target.name}` ({target.driver})" for target in configuration.targets)
    yield f"Looks for {targets} with the camera driver {configuration.camera.driver}{lens}."
    if configuration.messenger:
        yield f"Sends messages with {configuration.messenger.driver}."


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
    condition = f"{_acts(rule, configuration)} when `{rule.target}` {_begins(rule.condition)}{_delay(rule.on_delay)}"
    return f"{condition}; clears {_ends(rule)}.{_lost_alarm(rule)}{_wins(rule, configuration)}"


def _acts(rule: AlarmRule, configuration: Configuration) -> str:
    if rule.output is None:
        return f"gives the alert ({rule.severity})"
    if any(isinstance(output, BaseOutput) and output.name == rule.output for output in configuration.plan.outputs):
        return f"stops `{rule.output}`"
    level = "" if rule.level == 1 else f" at {rule.level:.0%}"
    return f"{_verb(rule.output, configuration)} `{rule.output}`{level}"


def _verb(output: str, configuration: Configuration) -> str:
    driver = next((each.driver for each in configuration.actuators if each.name == output), "")
    return _VERBS.get(driver, "drives")


def _begins(condition: Condition) -> str:
    if isinstance(condition, PresenceCondition):
        return "is in sight" if condition.seen else "is out of sight"
    certainty = condition.probability_on
    sure = "" if certainty is None else f" with a probability of {certainty:.0%}"
    return f"is {_interval(condition)}{sure}"


def _interval(condition: DistanceCondition) -> str:
    along = " along the optical axis" if condition.quantity == "depth" else ""
    if condition.above_m is not None and condition.below_m is not None:
        return f"between {length(condition.above_m)} and {length(condition.below_m)}{along}"
    if condition.above_m is not None:
        return f"further than {length(condition.above_m)}{along}"
    return f"nearer than {length(condition.below_m or 0.0)}{along}"


def _delay(delay: OnDelay) -> str:
    if delay.frames:
        return f" in {delay.frames} of {delay.of_frames} frames"
    return f" for {delay.hold_s:g} s" if delay.hold_s else ""


def _ends(rule: AlarmRule) -> str:
    held = f"for {rule.off_delay_s:g} s" if rule.off_delay_s else "at once"
    if isinstance(rule.condition, PresenceCondition):
        return f"when that has ended {held}"
    return f"when it is {_back(rule.condition)} {held}"


def _back(condition: DistanceCondition) -> str:
    """Say where the condition ends, which the deadband moves away from where it begins."""
    sigmas = condition.deadband_sigmas
    band_m = 0.0 if sigmas else condition.deadband_m
    ends = [f"nearer than {length(condition.above_m - band_m)}"] if condition.above_m is not None else []
    ends += [f"further than {length(condition.below_m + band_m)}"] if condition.below_m is not None else []
    if not sigmas:
        return " or ".join(ends)
    most = f"{condition.deadband_m:g} m or {sigmas:g} standard deviations, whichever is more,"
    return f"{' or '.join(ends)} by {most if condition.deadband_m else f'{sigmas:g} standard deviations'}"


def _lost_alarm(rule: AlarmRule) -> str:
    lost = rule.lost
    given_up = f", and goes to the safe state after {lost.fault_after_s:g} s" if rule.output else ""
    if isinstance(rule.condition, PresenceCondition):
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
    losers = " and ".join(f"`{each.name}`" for each in rivals if each.priority < rule.priority)
    return f" Goes before {losers}." if losers else ""


def _ramp(rule: RampRule, configuration: Configuration) -> str:
    output = rule.output or ""
    where = "further" if rule.full_m > rule.start_m else "nearer"
    along = " along the optical axis" if rule.quantity == "depth" else ""
    least = f"at least {rule.level_min:.0%}, " if rule.level_min else ""
    return (
        f"{_verb(output, configuration)} `{output}` when `{rule.target}` is {where} than {length(rule.start_m)}{along},"
        f" {least}{_full(rule.level_max)} at {length(rule.full_m)}; {_safe(output, configuration)} when lost."
        f"{_wins(rule, configuration)}"
    )


def _full(level: float) -> str:
    return "full" if level == 1 else f"{level:.0%}"


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
