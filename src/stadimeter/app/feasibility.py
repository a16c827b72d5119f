"""Warnings about rules that a camera and a target cannot serve: too far away, or too fine."""

from __future__ import annotations

from collections.abc import Iterator

from stadimeter.app.measuring import build_detectors
from stadimeter.config.describe import length
from stadimeter.config.findings import Finding, problems
from stadimeter.config.loader import Configuration
from stadimeter.config.toml_lines import key_places
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.plan import AlarmRule, AnyRule, DistanceCondition, FollowRule, RampRule
from stadimeter.core.target import TargetSize
from stadimeter.errors import Problem, StadimeterError
from stadimeter.ranging.feasibility import RELIABLE_PX, expect, farthest_m

_IDEAL = "ideal"
"""The simulated detector that needs no pixels."""


def feasibility_warnings(configuration: Configuration) -> tuple[Problem, ...]:
    """Say which rules ask for distances at which the target would be too small, or its distance too unsure.

    Nothing is opened. The camera is taken at the resolution that its model was made for.

    Args:
        configuration: The configuration.

    Returns:
        One warning for each limit that cannot be relied on, in the order of the file.
    """
    if configuration.camera_model is None:
        return ()
    sizes = _target_sizes(configuration)
    found = [
        finding
        for rule in configuration.plan.rules
        if rule.target in sizes
        for finding in _rule_findings(rule, sizes[rule.target], configuration.camera_model)
    ]
    return problems(found, str(configuration.path), key_places(configuration.text))


def _target_sizes(configuration: Configuration) -> dict[str, TargetSize]:
    """Return the sizes of those targets that are looked for in pictures."""
    sizes: dict[str, TargetSize] = {}
    for choice in configuration.targets:
        if choice.driver == _IDEAL:
            continue
        try:
            (target,) = build_detectors((choice,), configuration.camera_model)
        except StadimeterError:
            continue  # what cannot be built is said when it is run; its size is not known
        sizes[choice.name] = target.detector.target_size
    return sizes


def _rule_findings(rule: AnyRule, size: TargetSize, camera: CameraModel) -> Iterator[Finding]:
    kind, limits_m = _limits(rule)
    at = ("rules", rule.name, kind)
    farthest_limit_m = max(limits_m, default=0.0)
    if farthest_limit_m > 0 and not expect(size, camera, farthest_limit_m).is_reliable:
        yield _too_small(at, farthest_limit_m, rule.target, size, camera)
    if isinstance(rule, AlarmRule) and isinstance(rule.condition, DistanceCondition):
        for limit_m in limits_m:
            yield from _too_unsure(at, limit_m, rule.condition.deadband_sigmas, size, camera)


def _limits(rule: AnyRule) -> tuple[str, tuple[float, ...]]:
    """Return the key of the rule that has its limits, and these."""
    match rule:
        case RampRule():
            return "ramp", (rule.start_m, rule.full_m)
        case FollowRule():
            return "follow", (rule.distance_m,)
        case AlarmRule(condition=DistanceCondition() as condition):
            return "when", tuple(each for each in (condition.above_m, condition.below_m) if each)
        case AlarmRule():
            return "when", ()


def _too_small(at: tuple[str, ...], limit_m: float, target: str, size: TargetSize, camera: CameraModel) -> Finding:
    expected = expect(size, camera, limit_m)
    message = (
        f"at {length(limit_m)} '{target}' will be {_pixels(expected.size_px)} wide in a picture of {camera.width_px}x"
        f"{camera.height_px}, and its distance sure to ± {expected.sigma_m:.2f} m; below {RELIABLE_PX:g} px it is not "
        "found reliably"
    )
    times = RELIABLE_PX / expected.size_px
    hint = (
        f"a target, or a picture, {times:.1f} times as large would do, or a limit within "
        f"{length(farthest_m(size, camera))}"
    )
    return Finding(at, message, hint)


def _too_unsure(
    at: tuple[str, ...], limit_m: float, deadband_sigmas: float, size: TargetSize, camera: CameraModel
) -> Iterator[Finding]:
    sigma_m = expect(size, camera, limit_m).sigma_m
    if deadband_sigmas * sigma_m <= limit_m / 2:
        return
    message = (
        f"at {length(limit_m)} the distance is sure to ± {sigma_m:.2f} m only; with a deadband of {deadband_sigmas:g} "
        f"standard deviations, {deadband_sigmas * sigma_m:.2f} m, an alarm may not end"
    )
    yield Finding(at, message, "a larger target, more pixels, a better calibration or a nearer limit helps")


def _pixels(size_px: float) -> str:
    return f"{size_px:.0f} px" if size_px >= 1 else "less than 1 px"
