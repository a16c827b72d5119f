"""Warnings about rules that a camera and a target cannot serve: too far, near, fine or slow, or out of the picture."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress

from stadimeter.app.bootstrap import build
from stadimeter.app.certificate import certificate_findings, ends_of
from stadimeter.app.detectors import build_detectors
from stadimeter.config.checks import MAX_BLIND_S
from stadimeter.config.findings import Finding, problems
from stadimeter.config.loader import Configuration
from stadimeter.config.rules.compiled import CompiledRule, WrittenCondition
from stadimeter.config.toml_lines import KeyPath
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.conditions.quantities import probability_between
from stadimeter.core.detection import TargetShape
from stadimeter.core.rule import AlarmRule, RampRule, ReportRule
from stadimeter.core.words import length
from stadimeter.errors import Problem, StadimeterError
from stadimeter.ranging.similar_triangles import RELIABLE_PX, expect, farthest_m


def direction_findings(at: KeyPath, condition: FigureCondition, camera: CameraModel) -> Iterator[Finding]:
    """Find conditions on directions outside the picture, as it is along its middle without the lens's distortion."""
    if condition.quantity == "bearing":  # positive to the right
        ends_px, focal_px = (-camera.cx_px, camera.width_px - 1 - camera.cx_px), camera.fx_px
    else:  # positive upwards
        ends_px, focal_px = (camera.cy_px + 1 - camera.height_px, camera.cy_px), camera.fy_px
    low_rad, high_rad = (math.atan(end_px / focal_px) for end_px in ends_px)
    above_rad, below_rad = condition.limits
    if above_rad >= high_rad or below_rad <= low_rad:
        seen = f"{math.degrees(low_rad):.0f}° to {math.degrees(high_rad):.0f}°"
        message = f"no {condition.quantity} in the picture meets this: the camera sees from {seen}"
        yield Finding(at, message, "choose a limit within that, or a wider lens", "unreachable")


def feasibility_warnings(configuration: Configuration) -> tuple[Problem, ...]:
    """Say which rules ask for what the camera cannot see, or not well enough, of the target.

    Nothing is opened. The camera is taken at the resolution that its model was made for. A certificate of the site that
    is beside the configuration says which thresholds the site does not carry.

    There is one warning for each limit that cannot be relied on, in the order of the file.
    """
    if configuration.camera_model is None:
        return ()
    slow = _frames_too_slow(configuration)
    sizes = _target_sizes(configuration)
    camera = configuration.camera_model
    found = (finding for compiled in configuration.rules for finding in _rule_findings(compiled, sizes, camera))
    unique = list(dict.fromkeys(found))  # a rule with several targets says the same of each
    of_site = certificate_findings(configuration)
    return problems([*slow, *unique, *of_site], str(configuration.path), configuration.spans)


# Outputs go on through one frame that is missing if they may act for this many periods on one.
FRAMES_OF_AGE = 2.5


def _frames_too_slow(configuration: Configuration) -> Iterator[Finding]:
    """Find a camera whose frames are too old to act on before the next one comes. A recording has all the time."""
    rate_hz = getattr(configuration.camera.options, "rate", None)
    longest_s = configuration.plan.safety.max_frame_age_s
    if not rate_hz or 1 / rate_hz < longest_s or not configuration.plan.outputs:
        return
    with suppress(StadimeterError):  # what cannot be built is said by others
        if build(configuration).is_live:
            message = (
                f"at {rate_hz:g} frames a second each picture is {1e3 / rate_hz:.0f} ms old when the next one comes, "
                f"and safety.max_frame_age is {1e3 * longest_s:.0f} ms: no output ever acts"
            )
            age = f'"{min(round(FRAMES_OF_AGE / rate_hz, 2), MAX_BLIND_S):g} s"'
            hint = f"take more frames, or write max_frame_age = {age} in [safety], and each lease as long"
            yield Finding(("camera", "rate"), message, hint, "rate-too-low")


def _target_sizes(configuration: Configuration) -> dict[str, TargetShape]:
    """Return the sizes of those targets that are looked for in pictures."""
    sizes: dict[str, TargetShape] = {}
    for choice in configuration.targets:
        if not choice.options.needs_pixels:
            continue
        try:
            (target,) = build_detectors((choice,), configuration.camera_model)
        except StadimeterError:
            continue  # what cannot be built is said when it is run; its size is not known
        shape = target.detector.target_shape
        sizes |= dict.fromkeys(choice.members, shape)
        of_several = (each for each in configuration.plan.nearest if each.members == choice.members)
        sizes |= dict.fromkeys((each.name for each in of_several), shape)
    return sizes


def _rule_findings(compiled: CompiledRule, sizes: Mapping[str, TargetShape], camera: CameraModel) -> Iterator[Finding]:
    rule = compiled.rule
    if isinstance(rule, AlarmRule):
        when, *_ = compiled.conditions()
        yield from _condition_findings(when, sizes, camera)
    elif isinstance(rule, ReportRule):
        return
    elif rule.target in sizes and (ends_m := ends_of(rule)):
        path = compiled.at("ramp" if isinstance(rule, RampRule) else "follow")
        yield from _too_small(path, max(ends_m), rule.target, sizes[rule.target], camera)


def _condition_findings(
    condition: WrittenCondition, sizes: Mapping[str, TargetShape], camera: CameraModel
) -> Iterator[Finding]:
    for written in condition.leaves():
        match written.condition:
            case DistanceCondition() as leaf if leaf.target in sizes:
                yield from _distance_findings(written.path, leaf, sizes[leaf.target], camera)
            case FigureCondition(quantity="bearing" | "elevation", other="") as leaf if leaf.target in sizes:
                yield from direction_findings(written.limits_path, leaf, camera)
            case _:
                pass


def _distance_findings(
    at: KeyPath, condition: DistanceCondition, size: TargetShape, camera: CameraModel
) -> Iterator[Finding]:
    limits_m = [each for each in (condition.above, condition.below) if each]
    nearest_m = farthest_m(size, camera, min(camera.width_px, camera.height_px))
    if condition.below is not None and condition.below <= nearest_m:
        yield _too_near(at, condition, nearest_m, camera)
        return
    yield from _too_small(at, max(limits_m, default=0.0), condition.target, size, camera)
    for limit_m in limits_m:
        yield from _too_noisy(at, limit_m, condition, size, camera)
    yield from _too_narrow(at, condition, size, camera)


def _too_near(at: KeyPath, condition: DistanceCondition, nearest_m: float, camera: CameraModel) -> Finding:
    message = (
        f"'{condition.target}' is larger than a picture of {camera.width_px}x{camera.height_px} when it is nearer than "
        f"{length(nearest_m)}: within {length(condition.below or 0.0)} it is never measured"
    )
    return Finding(at, message, "a smaller target, a wider lens or a further limit helps", "unreachable")


def _too_small(at: KeyPath, limit_m: float, target: str, size: TargetShape, camera: CameraModel) -> Iterator[Finding]:
    if limit_m <= 0 or (expected := expect(size, camera, limit_m)).is_reliable:
        return
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
    yield Finding(at, message, hint, "unresolvable")


def _too_noisy(
    at: KeyPath, limit_m: float, condition: DistanceCondition, size: TargetShape, camera: CameraModel
) -> Iterator[Finding]:
    noise_m = expect(size, camera, limit_m).noise_m
    band_m = condition.deadband_sigmas * noise_m
    if band_m <= limit_m / 2:
        return
    message = (
        f"at {length(limit_m)} the distance differs by ± {noise_m:.2f} m from frame to frame; with a deadband of "
        f"{condition.deadband_sigmas:g} standard deviations, {band_m:.2f} m, an alarm may not end"
    )
    yield Finding(at, message, "a larger target, more pixels or a nearer limit helps", "unresolvable")


def _too_narrow(at: KeyPath, condition: DistanceCondition, size: TargetShape, camera: CameraModel) -> Iterator[Finding]:
    """Find limits so near to each other that a distance is never surely enough between them."""
    low_m, high_m, likely_on = condition.above, condition.below, condition.probability_on
    if not low_m or high_m is None or likely_on is None or high_m <= low_m:
        return
    within = [expect(size, camera, low_m + (high_m - low_m) * step / 20) for step in range(1, 20)]
    likely, sigma_m = max(
        (probability_between(low_m, high_m, there.distance_m, there.sigma_m), there.sigma_m) for there in within
    )
    if likely >= likely_on:
        return
    message = (
        f"the distance is sure to ± {sigma_m:.2f} m only, so it is between {length(low_m)} and {length(high_m)} with a "
        f"probability of {likely:.0%} at most, and {likely_on:.0%} is asked for: this may never begin"
    )
    yield Finding(at, message, "a better calibration, a wider range or a lower probability helps", "unresolvable")


def _pixels(size_px: float) -> str:
    return f"{size_px:.0f} px" if size_px >= 1 else "less than 1 px"
