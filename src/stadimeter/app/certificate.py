"""The certificate of a site: what was measured there with taped distances, and what each rule may rely on.

It is a file beside the configuration. `check` reads it: which threshold the site does not carry, and whether it still is
about this lens and this target.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from statistics import NormalDist
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.app.detectors import build_detectors
from stadimeter.app.exact_json import decode, encode
from stadimeter.config.atomic_file import write_all_atomically
from stadimeter.config.findings import Finding
from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.toml_lines import KeyPath
from stadimeter.config.untrusted_file import JSON_MAX_BYTES, read_untrusted_text, sha256_of
from stadimeter.core.camera_model import Provenance
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.figures import probability_below
from stadimeter.core.rule import AlarmRule, FollowRule, RampRule
from stadimeter.core.words import length
from stadimeter.errors import ConfigError, StadimeterError, UnreadableError, reason_of
from stadimeter.ranging.site_fit import Placement, Reach, SiteFit, noise_at_m

# What a threshold may be beyond the last placement or limit and still count as there.
ROUNDING_M = 0.005


class Certificate(Struct, frozen=True, kw_only=True):
    """What was found out about a site, or, without a fit, what has been measured so far.

    Attributes:
        date: When, in local time, ISO 8601.
        target: The name of the target in the configuration.
        camera: The camera, with its serial number where that is known.
        lens: A fingerprint of the camera model; likewise `size` of the target's size, and of the whole configuration.
        corrected: By which share the focal length was corrected in the end; 0 for not.
        background: What tells later whether the camera was moved; None where that was not looked for.
    """

    date: str
    target: str
    camera: str
    lens: str
    size: str
    configuration: str
    placements: tuple[Placement, ...] = ()
    fit: SiteFit | None = None
    reach: Reach | None = None
    corrected: float = 0.0
    background: Any = None


def certificate_file(configuration: Path) -> Path:
    """Return where the certificate of a configuration is, or will be."""
    return configuration.with_suffix(".certificate.json")


def load_certificate(file: Path) -> Certificate | None:
    """Return a certificate; None if there is none.

    Raises:
        ConfigError: It cannot be read.
    """
    try:
        return decode(read_untrusted_text(file, JSON_MAX_BYTES), Certificate)
    except (UnreadableError, ValueError) as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return None
        raise ConfigError(f"the certificate {file} cannot be read: {error}; measure anew with --anew") from error


def save_certificate(file: Path, certificate: Certificate, pages: dict[Path, bytes] | None = None) -> None:
    """Write or replace a certificate, and its pages with it; a `ConfigError` if that is not possible."""
    try:
        write_all_atomically({file: encode(certificate) + b"\n", **(pages or {})})
    except OSError as error:
        raise ConfigError(f"the certificate {file} cannot be written: {reason_of(error)}") from error


def fingerprints(configuration: Configuration, target: DriverChoice) -> dict[str, str]:
    """Return what a certificate is about, in figures that change with it: lens, size, configuration."""
    (named,) = build_detectors((target,), configuration.camera_model)
    shape, model = named.detector.target_shape, configuration.camera_model
    lens = encode(model and replace(model, provenance=Provenance())).decode()
    texts = {"lens": lens, "size": repr((shape.longest_m, shape.shortest_m)), "configuration": configuration.text}
    return {key: sha256_of(text)[:16] for key, text in texts.items()}


def site_target(configuration: Configuration, name: str = "") -> DriverChoice:
    """Return the target that a site is certified with: a named one, or the first that is seen in pictures.

    Raises:
        ConfigError: There is none of that name, or none that is measured.
    """
    known = {each.name: each for each in configuration.targets if each.options.needs_pixels}
    if configuration.camera_model is None or not known:
        raise ConfigError(f"{configuration.path} has no camera model, or no target that is measured in pictures")
    if name and name not in known:
        raise ConfigError(f"there is no target {name!r}; there are {', '.join(known)}")
    return known[name] if name else next(iter(known.values()))


def distances_used(
    configuration: Configuration, target: DriverChoice
) -> Iterator[tuple[KeyPath, str, float, DistanceCondition | None]]:
    """Yield each distance of a target that rules go by: where it stands, in words, in metres, and its condition."""
    names = {*target.members, *(each.name for each in configuration.plan.nearest if each.members == target.members)}
    for each in configuration.rules:
        rule = each.rule
        if isinstance(rule, AlarmRule):
            for leaf in (leaf for written in each.conditions() for leaf in written.leaves()):
                condition = leaf.leaf
                if not isinstance(condition, DistanceCondition) or condition.target not in names:
                    continue
                for word, limit_m in (("below", condition.below_m), ("above", condition.above_m)):
                    if limit_m:
                        yield leaf.path, f"{rule.name}: {word} {length(limit_m)}", limit_m, condition
        elif isinstance(rule, FollowRule) and rule.target in names:
            yield each.at("follow"), f"{rule.name}: follows at {length(rule.distance_m)}", rule.distance_m, None
        elif isinstance(rule, RampRule) and rule.target in names and rule.quantity in {"distance", "depth"}:
            ends = (at for at, _ in rule.points) if rule.points else (rule.start, rule.full)
            yield from ((each.at("ramp"), f"{rule.name}: ramp at {length(at)}", at, None) for at in ends if at > 0)


class Reliance(Struct, frozen=True, kw_only=True):
    """What a rule may rely on at one of its distances.

    Attributes:
        at: Where that stands in the configuration.
        words: The rule and the distance, such as ``near: below 1.00 m (3.3 ft)``.
        sigma_m: The standard deviation of one reading there, with that of the bias.
        bias_m: By how much it is too long on average.
        deadband_m: How far the target must come back; None where nothing switches, like the two below.
        false_alarm: How likely one reading begins the condition while the target is a deadband outside of it.
        miss: How likely one does not, a deadband inside.
        trouble: Why the site does not carry it; empty if it does.
        code: The kind of that.
    """

    at: KeyPath
    words: str
    sigma_m: float
    bias_m: float
    deadband_m: float | None = None
    false_alarm: float | None = None
    miss: float | None = None
    trouble: str = ""
    code: str = ""


def reliances(configuration: Configuration, certificate: Certificate) -> Iterator[Reliance]:
    """Yield what rules may rely on at each of their distances, by a certificate that has a fit."""
    fit, reach, target = certificate.fit, certificate.reach, site_target(configuration, certificate.target)
    if fit is None or reach is None:
        return
    for at, words, limit_m, condition in distances_used(configuration, target):
        noise_m, (bias_m, bias_sigma_m) = noise_at_m(certificate.placements, limit_m), fit.bias_m(limit_m)
        here = Reliance(at=at, words=words, bias_m=bias_m, sigma_m=math.hypot(noise_m, bias_sigma_m))
        if condition is not None:
            here = _with_odds(here, condition, noise_m, is_below=limit_m == condition.below_m)
        if limit_m > reach.reliable_m + ROUNDING_M:
            by_model = (
                f", by the error model to {length(reach.expected_m)}" if reach.expected_m > reach.reliable_m else ""
            )
            trouble = f"the site was found reliable to {length(reach.reliable_m)}{by_model}; then {reach.limit}"
            here = replace(here, trouble=trouble, code="site-too-far")
        yield here


def _with_odds(here: Reliance, condition: DistanceCondition, noise_m: float, *, is_below: bool) -> Reliance:
    """Return the odds of one reading; a run averages several, and does better.

    With x how far a reading is on the wrong side of the threshold, the condition begins where x ≤ -z σ, z being the
    quantile of the probability that it asks for. x is normal, with the deadband outside and the bias as its mean.
    """
    band_m = max(condition.deadband_m, condition.deadband_sigmas * noise_m)
    begins_m = -NormalDist().inv_cdf(min(max(condition.probability_on or 0.5, 1e-9), 1 - 1e-9)) * here.sigma_m
    bias_m = here.bias_m if is_below else -here.bias_m
    trouble = f"its deadband of {100 * band_m:.1f} cm is smaller than the scatter here, ± {100 * noise_m:.1f} cm"
    return replace(
        here,
        deadband_m=band_m,
        false_alarm=probability_below(begins_m, bias_m + band_m, here.sigma_m),
        miss=1 - probability_below(begins_m, bias_m - band_m, here.sigma_m),
        trouble=trouble if band_m < noise_m else "",
        code="site-deadband" if band_m < noise_m else "",
    )


_AGAIN = "measure again with `stadimeter certify`"


def certificate_findings(configuration: Configuration) -> Iterator[Finding]:
    """Find thresholds that the site does not carry, by the certificate beside the configuration, if there is one."""
    try:
        certificate = load_certificate(certificate_file(configuration.path))
        if certificate is not None:
            yield from _outdated(configuration, certificate) or _uncarried(configuration, certificate)
    except ConfigError as error:
        yield Finding(("camera",), str(error), _AGAIN, "certificate")


def _outdated(configuration: Configuration, certificate: Certificate) -> tuple[Finding, ...]:
    try:
        now = fingerprints(configuration, site_target(configuration, certificate.target))
    except StadimeterError as error:
        return (
            Finding(("targets",), f"the certificate of {certificate.date}: {error}", _AGAIN, "certificate-outdated"),
        )
    about = {"lens": (("camera", "model"), "lens"), "size": (("targets", certificate.target), "size of the target")}
    return tuple(
        Finding(at, f"the certificate of {certificate.date} is for another {word}", _AGAIN, "certificate-outdated")
        for key, (at, word) in about.items()
        if now[key] != getattr(certificate, key)
    )


def _uncarried(configuration: Configuration, certificate: Certificate) -> Iterator[Finding]:
    for each in reliances(configuration, certificate):
        if each.trouble:
            hint = "choose a nearer threshold, a wider deadband or a larger target, or more light"
            yield Finding(each.at, f"by the certificate of {certificate.date}, {each.trouble}", hint, each.code)
