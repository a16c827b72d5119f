"""Certifying simulated sites: how often the truth is within what is stated, and which errors of the scale are found."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec import Struct

from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.ranging.site_fit import LASTING_SHARE, SIGMAS_95, Placement, SiteFit, fit_site, read_placement

TAPE_M = 0.002
FOCAL_PX = 600.0


class Site(Struct, frozen=True, kw_only=True):
    """What is truly wrong at a site.

    Attributes:
        scale: By which share distances are too long: through the focal length, and through the size of the ball.
        offset_m: How far the lens is behind the mark.
        edge: By how many standard deviations the edge bias is off.
    """

    scale: float
    offset_m: float
    edge: float
    radius_m: float
    edge_sigma_px: float
    placements: tuple[Placement, ...]

    @property
    def fit(self) -> SiteFit:
        """What is found out about it."""
        return fit_site(self.placements)

    def bias_m(self, distance_m: float) -> float:
        """Return by how much a distance is truly measured too long."""
        edge_m = -self.edge * self.edge_sigma_px * distance_m**2 / (FOCAL_PX * self.radius_m)
        return self.scale * distance_m + self.offset_m + edge_m


def draw_site(seed: int, *, is_right: bool = False) -> Site:
    """Draw a site by the error model: five placements from 0.5 m to where the ball is 15 to 40 px large.

    The readings of a placement have noise with a memory, an error that stays, and the tape's two errors. Half of the
    error of the scale is the ball's size, half the focal length's. The edge bias is known to 0.02 to 0.1 px.

    Args:
        is_right: Whether the scale is exactly right.
    """
    rng = np.random.default_rng((seed, 380))
    radius_m = float(rng.choice([0.0335, 0.05, 0.1]))
    far_m = max(1.5, FOCAL_PX * 2 * radius_m / float(rng.uniform(15, 40)))
    places_m = np.geomspace(0.5, far_m, 5)
    scale = 0.0 if is_right else float(rng.uniform(0.0, 0.05) * rng.choice([-1, 1]))
    focal, size = ((1 + scale) ** share - 1 for share in (0.5, 0.5))
    offset_m, edge, edge_sigma_px = float(rng.normal(0, 0.02)), float(rng.normal()), float(rng.uniform(0.02, 0.1))
    zero_m, memory, share = float(rng.normal(0, TAPE_M)), float(rng.uniform(0, 0.9)), float(rng.uniform(0.002, 0.02))
    placements = []
    for tape_m in places_m.tolist():
        stands_m = tape_m + zero_m + float(rng.normal(0, TAPE_M)) + radius_m / (1 + size)
        stated_m = share * stands_m**2 / far_m
        noise_m = np.zeros(60)
        for number in range(len(noise_m)):
            fresh_m = float(rng.normal(0, 0.3 * stated_m * math.sqrt(1 - memory**2)))
            noise_m[number] = memory * noise_m[number - 1] + fresh_m if number else float(rng.normal(0, 0.3 * stated_m))
        size_px = FOCAL_PX * 2 * radius_m / stands_m
        edge_m = -2 * edge * edge_sigma_px / size_px * stands_m
        constant_m = offset_m + edge_m + float(rng.normal(0, LASTING_SHARE * stated_m))
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
        placements.append(read_placement(placed, seen, edge_sigma_px))
    return Site(
        scale=scale,
        offset_m=offset_m,
        edge=edge,
        radius_m=radius_m,
        edge_sigma_px=edge_sigma_px,
        placements=tuple(placements),
    )


def covered(sites: list[Site]) -> dict[str, float]:
    """Return in which shares of sites the truth is within the stated 95 % interval."""
    found: dict[str, list[bool]] = {"bias": [], "scale": [], "offset": []}
    for site in sites:
        fit = site.fit
        for placed in site.placements:
            bias_m, sigma_m = fit.bias_m(placed.true_m)
            found["bias"].append(abs(bias_m - site.bias_m(placed.true_m)) <= SIGMAS_95 * sigma_m)
        found["scale"].append(abs(fit.scale - site.scale) <= SIGMAS_95 * fit.scale_sigma)
        found["offset"].append(abs(fit.offset_m - site.offset_m) <= SIGMAS_95 * fit.offset_sigma_m)
    return {what: float(np.mean(each)) for what, each in found.items()}
