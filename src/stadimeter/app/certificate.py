"""The certificate of a site: what was measured there with taped distances, and what each rule may rely on.

It is a file beside the configuration. By it `check` says which threshold the site does not carry, and when it is no
longer about this lens and this target.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.app.detectors import build_detectors
from stadimeter.app.exact_json import decode, encode
from stadimeter.app.places import CERTIFICATE
from stadimeter.config.files import JSON_MAX_BYTES, read_untrusted_text, sha256_of, write_all_atomically
from stadimeter.config.findings import Finding
from stadimeter.config.loader import Configuration
from stadimeter.config.toml_lines import KeyPath
from stadimeter.core.camera_model import Provenance
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.rule import AlarmRule, FollowRule, RampRule
from stadimeter.core.words import length
from stadimeter.errors import ConfigError, StadimeterError, UnreadableError, reason_of
from stadimeter.ranging.site_fit import Placement, Reach, SiteFit, noise_at_m

# How far beyond what was measured a threshold may be and still count as there.
ROUNDING_M = 0.005

# How much of a SHA-256 a certificate shows.
FINGERPRINT = 16


class Certificate(Struct, frozen=True, kw_only=True):
    """The findings about a site; without a fit, what has been measured so far.

    Attributes:
        about: Fingerprints of the camera model, of the target's size and of the whole configuration.
        target: The name of the target in the configuration.
        date: When, in local time.
        background: Whether the view was saved that tells later whether the camera was moved, in words; None where
            that was not tried.
    """

    about: dict[str, str]
    target: str
    date: str = ""
    placements: tuple[Placement, ...] = ()
    fit: SiteFit | None = None
    reach: Reach | None = None
    background: str | None = None


class Reliance(Struct, frozen=True, kw_only=True):
    """The figures that a rule may rely on at one of its distances.

    Attributes:
        at: Where that stands in the configuration.
        words: The rule and the distance, such as ``near: below 1.00 m``.
        sigma_m: The standard deviation of one reading there, with that of the bias.
        bias_m: By how much it is too long on average.
        trouble: Why the site does not carry it; empty if it does.
    """

    at: KeyPath
    words: str
    sigma_m: float
    bias_m: float
    trouble: str = ""


# Where a distance stands in the configuration, the rule and it in words, in metres, and the condition that has it.
UsedDistance = tuple[KeyPath, str, float, DistanceCondition | None]


class Site:
    """A configuration and the target that it is certified with: a named one, or the first that is seen in pictures.

    Raises:
        ConfigError: There is none of that name, or none that is measured.
    """

    def __init__(self, configuration: Configuration, name: str = "") -> None:
        known = {each.name: each for each in configuration.targets if each.options.needs_pixels}
        model = configuration.camera_model
        if model is None or not known:
            raise ConfigError(f"{configuration.path} has no camera model, or no target that is measured in pictures")
        if name and name not in known:
            raise ConfigError(f"there is no target {name!r} that a camera measures; there are: {', '.join(known)}")
        self.configuration, self.model = configuration, model
        self.target = known[name or next(iter(known))]
        (self.named,) = build_detectors((self.target,), model, configuration.footings)
        self.shape = self.named.detector.target_shape
        lens = encode(replace(model, provenance=Provenance())).decode()
        size = repr((self.shape.longest_m, self.shape.shortest_m))
        texts = {"camera model": lens, "size of the target": size, "configuration": configuration.text}
        self.about = {what: sha256_of(text)[:FINGERPRINT] for what, text in texts.items()}

    def outdated(self, certificate: Certificate) -> str:
        """Return why a certificate is no longer about this site; empty if it is. Other parts may change."""
        parts = ("camera model", "size of the target")
        changed = [part for part in parts if self.about[part] != certificate.about.get(part)]
        return f"the {' and the '.join(changed)} changed since" if changed else ""

    def distances(self) -> Iterator[UsedDistance]:
        """Yield each distance of the target that rules go by."""
        members, nearest = self.target.members, self.configuration.plan.nearest
        names = {*members, *(each.name for each in nearest if each.members == members)}
        for each in self.configuration.rules:
            rule = each.rule
            if isinstance(rule, AlarmRule):
                for leaf in (leaf for when in each.conditions() for leaf in when.leaves()):
                    found = leaf.condition
                    if isinstance(found, DistanceCondition) and found.target in names:
                        ends = (("below", found.below), ("above", found.above))
                        yield from (
                            (leaf.path, f"{rule.name}: {word} {at:.2f} m", at, found) for word, at in ends if at
                        )
            elif isinstance(rule, FollowRule | RampRule) and rule.target in names:
                key = "follow" if isinstance(rule, FollowRule) else "ramp"
                yield from (
                    (each.at(key), f"{rule.name}: {key} {at:.2f} m", at, None) for at in ends_of(rule) if at > 0
                )

    def reliances(self, certificate: Certificate) -> Iterator[Reliance]:
        """Yield what rules may rely on at each of their distances, by a certificate that has a fit."""
        fit, reach = certificate.fit, certificate.reach
        if fit is None or reach is None:
            return
        for at, words, limit_m, condition in self.distances():
            noise_m, (bias_m, bias_sigma_m) = noise_at_m(certificate.placements, limit_m), fit.bias_m(limit_m)
            sigma_m, trouble = math.hypot(noise_m, bias_sigma_m), ""
            if condition is not None:
                band_m = max(condition.deadband, condition.deadband_sigmas * noise_m)
                if band_m < noise_m:
                    trouble = (
                        f"the deadband of {100 * band_m:.1f} cm is smaller than the scatter, ± {100 * noise_m:.1f} cm"
                    )
            if limit_m < reach.nearest_m - ROUNDING_M:
                trouble = f"it was not seen nearer than {length(reach.nearest_m)}"
            if limit_m > reach.reliable_m + ROUNDING_M:
                trouble = f"distances were found reliable to {length(reach.reliable_m)}, where {reach.limit}"
            yield Reliance(at=at, words=words, bias_m=bias_m, sigma_m=sigma_m, trouble=trouble)


def load_certificate(configuration: Path, ending: str = CERTIFICATE) -> Certificate | None:
    """Return the certificate beside a configuration; None if there is none.

    Raises:
        ConfigError: It cannot be read.
    """
    file = configuration.with_suffix(ending)
    try:
        return decode(read_untrusted_text(file, JSON_MAX_BYTES), Certificate)
    except (UnreadableError, ValueError) as error:
        if isinstance(error.__cause__, FileNotFoundError):
            return None
        raise ConfigError(f"{file} cannot be read: {error}; delete it, or certify with --anew") from error


def save_certificate(configuration: Path, made: Certificate, ending: str, pages: Mapping[str, bytes] = {}) -> None:
    """Write or replace a certificate beside a configuration, and its pages by their endings, all of them or none.

    Raises:
        ConfigError: One cannot be written.
    """
    files = {configuration.with_suffix(each): data for each, data in {ending: encode(made) + b"\n", **pages}.items()}
    try:
        write_all_atomically(files)
    except OSError as error:
        raise ConfigError(f"the certificate cannot be written beside {configuration}: {reason_of(error)}") from error


def ends_of(rule: FollowRule | RampRule) -> tuple[float, ...]:
    """Return the distances that a rule goes by; nothing of a ramp over something else."""
    if isinstance(rule, FollowRule):
        return (rule.distance_m,)
    is_distance = rule.quantity in {"distance", "depth"}
    return (tuple(at for at, _ in rule.points) or (rule.start, rule.full)) if is_distance else ()


def certificate_findings(configuration: Configuration) -> Iterator[Finding]:
    """Find thresholds that the site does not carry, by the certificate beside the configuration, if there is one."""
    hint, code = "certify again with `stadimeter site certify`", "certificate-outdated"
    try:
        made = load_certificate(configuration.path)
        site = Site(configuration, made.target) if made else None
        if made is None or site is None:
            return
        if why := site.outdated(made):
            yield Finding(("camera",), f"the certificate of {made.date} is out of date: {why}", hint, code)
            return
        nearer = "a nearer threshold, a wider deadband, a larger target or more light helps"
        for each in site.reliances(made):
            if each.trouble:
                message = f"{each.words}: by the certificate of {made.date}, {each.trouble}"
                yield Finding(each.at, message, nearer, "not-carried")
    except StadimeterError as error:
        yield Finding(("camera",), f"the certificate of the site cannot be used: {error}", hint, code)
