"""The certificate of a site: what was measured there with taped distances, and what each rule may rely on.

It is a file beside the configuration. By it `check` says which threshold the site does not carry, and when it is no
longer about this lens and this target.
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

# What makes a certificate out of date: its fingerprints, in words.
ABOUT = {"lens": "the camera model", "size": "the size of the target"}

# What a threshold may be beyond the last placement or limit and still count as there.
ROUNDING_M = 0.005


class Certificate(Struct, frozen=True, kw_only=True):
    """What was found out about a site, or, without a fit, what has been measured so far.

    Attributes:
        date: When, in local time, ISO 8601.
        target: The name of the target in the configuration.
        camera: The camera, with its serial number where that is known.
        about: Fingerprints of the camera model, of the target's size and of the whole configuration, by `fingerprints`.
        corrected: By which share the focal length was corrected in the end; 0 for not.
        background: What tells later whether the camera was moved; None where that was not looked for.
    """

    date: str
    target: str
    camera: str
    about: dict[str, str]
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
        raise ConfigError(f"{file} cannot be read: {error}; delete it, or certify with --anew") from error


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


# Where a distance stands in the configuration, the rule and it in words, in metres, and the condition that has it.
UsedDistance = tuple[KeyPath, str, float, DistanceCondition | None]


def distances_used(configuration: Configuration, target: DriverChoice) -> Iterator[UsedDistance]:
    """Yield each distance of a target that rules go by."""
    names = {*target.members, *(each.name for each in configuration.plan.nearest if each.members == target.members)}
    for each in configuration.rules:
        rule = each.rule
        if isinstance(rule, AlarmRule):
            leaves = ((leaf.path, leaf.leaf) for when in each.conditions() for leaf in when.leaves())
            for path, leaf in leaves:
                if isinstance(leaf, DistanceCondition) and leaf.target in names:
                    ends = (("below", leaf.below_m), ("above", leaf.above_m))
                    yield from ((path, f"{rule.name}: {word} {at:.2f} m", at, leaf) for word, at in ends if at)
        elif isinstance(rule, FollowRule | RampRule) and rule.target in names:
            key = "follow" if isinstance(rule, FollowRule) else "ramp"
            yield from ((each.at(key), f"{rule.name}: {key} {at:.2f} m", at, None) for at in _ends_of(rule) if at > 0)


def _ends_of(rule: FollowRule | RampRule) -> tuple[float, ...]:
    if isinstance(rule, FollowRule):
        return (rule.distance_m,)
    if rule.quantity not in {"distance", "depth"}:
        return ()
    return tuple(at for at, _ in rule.points) or (rule.start, rule.full)


class Reliance(Struct, frozen=True, kw_only=True):
    """What a rule may rely on at one of its distances.

    Attributes:
        at: Where that stands in the configuration.
        words: The rule and the distance, such as ``near: below 1.00 m``.
        sigma_m: The standard deviation of one reading there, with that of the bias.
        bias_m: By how much it is too long on average.
        odds: The deadband in metres; how likely one reading begins the condition while the target is a deadband outside
            of it, and how likely one does not, a deadband inside. None where nothing switches.
        trouble: Why the site does not carry it; empty if it does.
    """

    at: KeyPath
    words: str
    sigma_m: float
    bias_m: float
    odds: tuple[float, float, float] | None = None
    trouble: str = ""


def reliances(configuration: Configuration, certificate: Certificate) -> Iterator[Reliance]:
    """Yield what rules may rely on at each of their distances, by a certificate that has a fit."""
    fit, reach, target = certificate.fit, certificate.reach, site_target(configuration, certificate.target)
    if fit is None or reach is None:
        return
    for at, words, limit_m, condition in distances_used(configuration, target):
        noise_m, (bias_m, bias_sigma_m) = noise_at_m(certificate.placements, limit_m), fit.bias_m(limit_m)
        sigma_m, odds, trouble = math.hypot(noise_m, bias_sigma_m), None, ""
        if condition is not None:
            band_m = max(condition.deadband_m, condition.deadband_sigmas * noise_m)
            odds = (band_m, *_odds(condition, band_m, bias_m if limit_m == condition.below_m else -bias_m, sigma_m))
            if band_m < noise_m:
                trouble = f"the deadband of {100 * band_m:.1f} cm is smaller than the scatter, ± {100 * noise_m:.1f} cm"
        if limit_m > reach.reliable_m + ROUNDING_M:
            by_model = (
                f", by the error model to {length(reach.expected_m)}" if reach.expected_m > reach.reliable_m else ""
            )
            trouble = f"distances were found reliable to {length(reach.reliable_m)}{by_model}, where {reach.limit}"
        yield Reliance(at=at, words=words, bias_m=bias_m, sigma_m=sigma_m, odds=odds, trouble=trouble)


def _odds(condition: DistanceCondition, band_m: float, bias_m: float, sigma_m: float) -> tuple[float, float]:
    """Return the odds of one reading; a run averages several, and does better.

    With x how far a reading is on the wrong side of the threshold, the condition begins where x ≤ -z σ, z being the
    quantile of the probability that it asks for. x is normal, with the deadband outside and the bias as its mean.
    """
    begins_m = -NormalDist().inv_cdf(min(max(condition.probability_on or 0.5, 1e-9), 1 - 1e-9)) * sigma_m
    miss = 1 - probability_below(begins_m, bias_m - band_m, sigma_m)
    return probability_below(begins_m, bias_m + band_m, sigma_m), miss


def certificate_findings(configuration: Configuration) -> Iterator[Finding]:
    """Find thresholds that the site does not carry, by the certificate beside the configuration, if there is one."""
    again = "measure again with `stadimeter certify`"
    try:
        made = load_certificate(certificate_file(configuration.path))
        if made is None:
            return
        words = outdated(configuration, made)
        if words:
            yield Finding(
                ("camera",), f"the certificate of {made.date} is out of date: {words}", again, "certificate-outdated"
            )
            return
        hint = "choose a nearer threshold, a wider deadband or a larger target; or see to the light and certify again"
        for each in reliances(configuration, made):
            if each.trouble:
                message = f"{each.words}: by the certificate of {made.date}, {each.trouble}"
                yield Finding(each.at, message, hint, "not-carried")
    except StadimeterError as error:
        yield Finding(
            ("camera",), f"the certificate of the site cannot be used: {error}", again, "certificate-outdated"
        )


def outdated(configuration: Configuration, certificate: Certificate) -> str:
    """Return why a certificate is no longer about this site; empty if it is."""
    now = fingerprints(configuration, site_target(configuration, certificate.target))
    changed = [words for key, words in ABOUT.items() if now[key] != certificate.about.get(key)]
    return f"{' and '.join(changed)} changed since" if changed else ""
