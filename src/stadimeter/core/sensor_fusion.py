"""Joins what the camera and a range sensor say of the same target, weighted by their variances.

With variances s² and t², the best estimate that is linear in both is (t²·d + s²·e) / (s² + t²), and its variance is
s²·t² / (s² + t²). Source: the textbook rule for two independent measurements, e.g. Y. Bar-Shalom, X. R. Li and
T. Kirubarajan, Estimation with Applications to Tracking and Navigation, section 3.2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.decision import Event, EventKind, Severity
from stadimeter.core.measurement import Measurement
from stadimeter.core.words import metres

# Two that are further apart than this many standard deviations of their difference do not measure the same thing, or
# one of them is wrong. By chance that is one in two million.
DISAGREEMENT_SIGMAS = 5.0

# An echo that is further from the picture in time than this is of another place: 5 cm at 0.5 m/s.
MAX_APART_S = 0.1


class SensorPair(Struct, frozen=True, kw_only=True):
    """A range sensor and the target that it measures too, as two measurements of those names.

    Attributes:
        half_beam_rad: The target is in the beam while it is no further than this from the sensor's bearing.
        radius_m: From the surface, which the sensor sees, to the centre of the target, which the camera measures.
    """

    sensor: str
    target: str
    half_beam_rad: float
    radius_m: float = 0.0


def fuse(
    measurements: Mapping[str, Measurement], pairs: Sequence[SensorPair]
) -> tuple[dict[str, Measurement], dict[str, str]]:
    """Return the measurements, joined where two are of the same target, and how far sensors agree with the camera.

    Returns:
        The measurements by target; and for each sensor that could be compared its disagreement in words, empty where
        it agrees. Where they disagree, the measurement of the camera stays as it is.
    """
    fused, compared = dict(measurements), {}
    for pair in pairs:
        seen, echo = _figures(fused.get(pair.target)), _figures(measurements.get(pair.sensor), pair.radius_m)
        if seen is None or echo is None or not _are_of_one(seen, echo, pair):
            continue
        apart = abs(seen.distance_m - echo.distance_m) / math.hypot(seen.sigma_m, echo.sigma_m)
        compared[pair.sensor] = _in_words(pair, seen, echo, apart) if apart > DISAGREEMENT_SIGMAS else ""
        if not compared[pair.sensor]:
            fused[pair.target] = _join(fused[pair.target], seen, echo)
    return fused, compared


def step_disagreements(
    before: frozenset[str], compared: Mapping[str, str], now_s: float
) -> tuple[frozenset[str], tuple[Event, ...]]:
    """Return the sensors that disagree with the camera by now, and the events of those that began or ceased to.

    Args:
        before: Those that did before. One that cannot be compared stays among them.
    """
    if not compared:
        return before, ()
    now = (before - compared.keys()) | {name for name, words in compared.items() if words}
    begun = [(name, EventKind.FAULT, compared[name], Severity.WARNING) for name in sorted(now - before)]
    ended = [
        (name, EventKind.FAULT_CLEARED, "it agrees with the camera again", Severity.INFO)
        for name in sorted(before - now)
    ]
    return now, tuple(
        Event(kind=kind, source=name, at_s=now_s, severity=severity, reason=reason)
        for name, kind, reason, severity in (*begun, *ended)
    )


class _Figures(NamedTuple):
    """A measurement that can be compared, to the centre of the target."""

    distance_m: float
    sigma_m: float
    noise_m: float
    bearing_rad: float
    at_s: float


def _figures(measured: Measurement | None, further_m: float = 0.0) -> _Figures | None:
    if measured is None or measured.distance_m is None or measured.bearing_rad is None or not measured.sigma_m:
        return None
    noise_m = measured.sigma_m if measured.noise_m is None else measured.noise_m
    distance_m = measured.distance_m + further_m
    figures = _Figures(distance_m, measured.sigma_m, noise_m, measured.bearing_rad, measured.captured_at_s)
    return figures if all(map(math.isfinite, figures)) else None


def _are_of_one(seen: _Figures, echo: _Figures, pair: SensorPair) -> bool:
    is_in_beam = abs(seen.bearing_rad - echo.bearing_rad) <= pair.half_beam_rad
    return is_in_beam and abs(seen.at_s - echo.at_s) <= MAX_APART_S


def _join(measured: Measurement, seen: _Figures, echo: _Figures) -> Measurement:
    weight = echo.sigma_m**2 / (seen.sigma_m**2 + echo.sigma_m**2)  # of the camera
    distance_m = weight * seen.distance_m + (1 - weight) * echo.distance_m
    return replace(
        measured,
        distance_m=distance_m,
        depth_m=None if measured.depth_m is None else measured.depth_m * distance_m / seen.distance_m,
        sigma_m=math.hypot(weight * seen.sigma_m, (1 - weight) * echo.sigma_m),
        noise_m=math.hypot(weight * seen.noise_m, (1 - weight) * echo.noise_m),
    )


def _in_words(pair: SensorPair, seen: _Figures, echo: _Figures, apart: float) -> str:
    camera, sensor = metres(seen.distance_m, seen.sigma_m), metres(echo.distance_m, echo.sigma_m)
    return f"{pair.target} is at {camera} for the camera and {sensor} for the sensor, {apart:.0f} σ apart"
