"""Sites to certify, drawn from the error model: how often the truth is within what is stated, and what is found."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.ranging.site_fit import (
    LASTING_SHARE,
    SIGMAS_95,
    WANTED_SCALE,
    Placement,
    SiteFit,
    fit_site,
    further_place_m,
    read_placement,
)
from stadimeter.workbench.certificate.session import MAX_FURTHER, PROPOSED, SAME_SHARE

LIKE_FITTED_PX = 0.03
"""The edge bias of a camera file that was made from near and from far, in pixels: one standard deviation."""

TAPE_M = 0.002
FOCAL_PX = 600.0


class Site(Struct, frozen=True, kw_only=True):
    """What is truly wrong at a site.

    Attributes:
        scale: By which share distances are too long: through the focal length, and through the size of the target.
        placements: Those that are read, in the order in which they were made.
        shift_m: How much farther the target's centre truly is than the tape and the stated size say: the lens behind
            the mark, and the radius of a ball whose size is wrong.
        edge: By how many standard deviations the edge bias is off.
        size_px_m: How large it appears in pixels, times its distance.
    """

    scale: float
    shift_m: float
    size_px_m: float
    placements: tuple[Placement, ...]
    edge: float = 0.0
    edge_sigma_px: float = 0.0

    @property
    def fit(self) -> SiteFit:
        """What is found out about it."""
        return fit_site(self.placements)

    @property
    def of_five(self) -> Site:
        """It with its first five placements."""
        return replace(self, placements=self.placements[:5])

    @property
    def offset_m(self) -> float:
        """By how much every distance is truly measured too long."""
        return (1 + self.scale) * self.shift_m

    def bias_m(self, distance_m: float) -> float:
        """Return by how much a distance is truly measured too long."""
        edge_m = -2 * self.edge * self.edge_sigma_px * distance_m**2 / self.size_px_m
        return self.scale * distance_m + self.offset_m + edge_m


def draw_site(seed: int, *, is_right: bool = False, is_large: bool = False, most: int = 5) -> Site:
    """Draw a site by the error model: five placements from 0.5 m to where the ball is 15 to 40 px large.

    The readings of a placement have noise with a memory, an error that stays, and the tape's two errors. Half of the
    error of the scale is the ball's size, half the focal length's.

    Args:
        is_right: Whether the scale is exactly right.
        most: How many placements there may be: more than five are made as `certify` proposes them.
        is_large: A ball of 20 cm to 3 m or farther before a camera whose edge bias is known to 0.03 px; else balls of
            6.7 to 20 cm to 1.5 m or farther, and edge biases known to 0.02 to 0.1 px.
    """
    rng = np.random.default_rng((seed, 380))
    radius_m = 0.1 if is_large else float(rng.choice([0.0335, 0.05, 0.1]))
    far_m = max(1.5, FOCAL_PX * 2 * radius_m / float(rng.uniform(15, 40)))
    scale = 0.0 if is_right else float(rng.uniform(0.0, 0.05) * rng.choice([-1, 1]))
    focal, size = ((1 + scale) ** share - 1 for share in (0.5, 0.5))
    offset_m, edge = float(rng.normal(0, 0.02)), float(rng.normal())
    edge_sigma_px = LIKE_FITTED_PX if is_large else float(rng.uniform(0.02, 0.1))
    zero_m, memory = float(rng.normal(0, TAPE_M)), float(rng.uniform(0, 0.9))
    share = float(rng.uniform(0.003, 0.012))  # as detectors state at 40 to 15 px

    def place(tape_m: float) -> Placement:
        stands_m = tape_m + zero_m + float(rng.normal(0, TAPE_M)) + offset_m + radius_m / (1 + size)
        stated_m = share * stands_m**2 / far_m
        noise_m = np.zeros(60)
        for number in range(len(noise_m)):
            fresh_m = float(rng.normal(0, 0.3 * stated_m * math.sqrt(1 - memory**2)))
            noise_m[number] = memory * noise_m[number - 1] + fresh_m if number else float(rng.normal(0, 0.3 * stated_m))
        size_px = FOCAL_PX * 2 * radius_m / stands_m
        constant_m = float(rng.normal(0, LASTING_SHARE * stated_m)) - 2 * edge * edge_sigma_px / size_px * stands_m
        read_m = (1 + focal) * (1 + size) * stands_m + constant_m + noise_m
        seen = [
            Measurement(
                target="ball", status=MeasurementStatus.MEASURED, captured_at_s=0.0,
                distance_m=each, sigma_m=stated_m, noise_m=stated_m,
            )
            for each in read_m.tolist()
        ]  # fmt: skip
        placed = Placement(
            tape_m=tape_m, true_m=tape_m + radius_m, tape_sigma_m=TAPE_M, frames=60, found=60, size_px=size_px
        )
        return read_placement(placed, seen, edge_sigma_px)

    placements = go_on([place(each) for each in np.geomspace(0.5, far_m, 5).tolist()], place, most)
    return Site(
        scale=scale,
        shift_m=offset_m + radius_m / (1 + size) - radius_m,
        size_px_m=FOCAL_PX * 2 * radius_m,
        placements=placements,
        edge=edge,
        edge_sigma_px=edge_sigma_px,
    )


def go_on(placements: list[Placement], place: Callable[[float], Placement], most: int) -> tuple[Placement, ...]:
    """Return those that are read, with what a session proposes after them while an error could go unnoticed."""
    read = [each for each in placements if each.is_read]
    while len(placements) < most and (fit := fit_site(read)).least_scale > WANTED_SCALE:
        done_m = [each.tape_m for each in placements]
        steps_m = (np.arange(6, 20 * max(each.tape_m for each in read) + 1e-6) / 20).tolist()
        left_m = [at for at in steps_m if all(abs(each / at - 1) > SAME_SHARE for each in done_m)]
        placements = [*placements, place(further_place_m(read, fit, left_m))]
        read = [each for each in placements if each.is_read]
    return tuple(read)


def covered(sites: list[Site]) -> dict[str, float]:
    """Return in which shares of sites the truth is within the stated 95 % interval, the bias at the middle distance."""
    found: dict[str, list[bool]] = {"bias": [], "scale": [], "offset": []}
    for site in sites:
        fit, middle_m = site.fit, sorted(each.true_m for each in site.placements)[len(site.placements) // 2]
        bias_m, sigma_m = fit.bias_m(middle_m)
        found["bias"].append(abs(bias_m - site.bias_m(middle_m)) <= SIGMAS_95 * sigma_m)
        found["scale"].append(abs(fit.scale - site.scale) <= SIGMAS_95 * fit.scale_sigma)
        found["offset"].append(abs(fit.offset_m - site.offset_m) <= SIGMAS_95 * fit.offset_sigma_m)
    return {what: float(np.mean(each)) for what, each in found.items()}


def claims(sites: list[Site], over: float = 0.0) -> list[bool]:
    """Return of each site whose scale is off by at least that whether it is found to be."""
    return [site.fit.has_wrong_scale for site in sites if abs(site.scale) >= over]


MIN_FOUND = WANTED_SCALE
"""From this error of the scale on, it must be found."""

MOST = PROPOSED + MAX_FURTHER
