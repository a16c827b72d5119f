"""What a site's distances tell of its scale and its offset, against drawn sites whose truth is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.errors import CalibrationError
from stadimeter.ranging.site_fit import (
    LASTING_SHARE,
    RELIABLE_RATE,
    SIGMAS_95,
    WANTED_SCALE,
    Placement,
    SiteFit,
    find_reach,
    fit_site,
    read_placement,
)

# Sites to certify, drawn from the error model: how often the truth is within what is stated, and what is found.

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
    def offset_m(self) -> float:
        """By how much every distance is truly measured too long."""
        return (1 + self.scale) * self.shift_m

    def bias_m(self, distance_m: float) -> float:
        """Return by how much a distance is truly measured too long."""
        edge_m = -2 * self.edge * self.edge_sigma_px * distance_m**2 / self.size_px_m
        return self.scale * distance_m + self.offset_m + edge_m


def draw_site(seed: int, *, is_right: bool = False, is_large: bool = False) -> Site:
    """Draw a site by the error model: five placements from 0.5 m to where the ball is 15 to 40 px large.

    The readings of a placement have noise with a memory, an error that stays, and the tape's two errors. Half of the
    error of the scale is the ball's size, half the focal length's.

    Args:
        is_right: Whether the scale is exactly right.
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

    placements = [place(each) for each in np.geomspace(0.5, far_m, 5).tolist()]
    return Site(
        scale=scale,
        shift_m=offset_m + radius_m / (1 + size) - radius_m,
        size_px_m=FOCAL_PX * 2 * radius_m,
        placements=tuple(each for each in placements if each.is_read),
        edge=edge,
        edge_sigma_px=edge_sigma_px,
    )


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

# What is wrong at a site follows from taped distances, as sure as it is said to be.

PLACES_M = (0.5, 1.0, 2.0, 3.0, 4.0)
UNREAD = Placement(tape_m=1.0, true_m=1.0, tape_sigma_m=0.002, frames=40, found=40, size_px=60.0)


def placements(scale: float = 0.0, offset_m: float = 0.0, noise_m: float = 0.001) -> list[Placement]:
    """Return placements that are read exactly as an error of the scale and an offset say; noise as at 1 m."""
    return [
        Placement(
            tape_m=at_m,
            true_m=at_m,
            tape_sigma_m=0.002,
            frames=50,
            found=50,
            read_m=(1 + scale) * at_m + offset_m,
            read_sigma_m=0.0005 * at_m**2,
            spread_m=noise_m * at_m**2,
            noise_m=noise_m * at_m**2,
            size_px=100 / at_m,
        )
        for at_m in PLACES_M
    ]


def seen(distances_m: list[float], noise_m: float = 0.002) -> list[Measurement]:
    return [
        Measurement(
            target="ball",
            status=MeasurementStatus.MEASURED,
            captured_at_s=0.0,
            distance_m=each,
            sigma_m=2 * noise_m,
            noise_m=noise_m,
        )
        for each in distances_m
    ]


@given(scale=st.floats(-0.3, 0.3), offset_m=st.floats(-0.2, 0.2))
def test_exact_readings_give_exactly_the_scale_and_the_offset(scale: float, offset_m: float) -> None:
    fit = fit_site(placements(scale, offset_m))
    assert (fit.scale, fit.offset_m) == pytest.approx((scale, offset_m), abs=1e-9)
    assert fit.is_consistent
    assert fit.has_wrong_scale == (abs(fit.scale) > SIGMAS_95 * fit.scale_sigma)
    assert fit.bias_m(2.5)[0] == pytest.approx(2.5 * scale + offset_m, abs=1e-9)


def test_the_zero_of_the_tape_widens_the_offset_and_not_the_scale() -> None:
    fit = fit_site([replace(each, read_sigma_m=0.0) for each in placements()])
    assert fit.offset_sigma_m > 0.002
    assert fit.covariance[1][1] == pytest.approx(fit.offset_sigma_m**2)


def test_an_edge_bias_that_is_not_known_makes_the_scale_less_sure() -> None:
    unsure = [replace(each, edge_m=-0.01 * each.true_m**2) for each in placements()]
    assert fit_site(unsure).scale_sigma > 2 * fit_site(placements()).scale_sigma


def test_a_bias_that_grows_with_the_square_of_the_distance_is_laid_to_the_edges() -> None:
    edges = [
        replace(each, edge_m=-0.004 * each.true_m**2, read_m=each.true_m - 0.006 * each.true_m**2)
        for each in placements()
    ]
    fit = fit_site(edges)
    assert fit.edge == pytest.approx(1.5, abs=0.2)
    assert not fit.has_wrong_scale


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_placements_say_how_many_are_needed(count: int) -> None:
    with pytest.raises(CalibrationError, match=f"seen at {count} distances: 3 or more are needed"):
        fit_site(placements()[:count])


def test_placements_beside_each_other_tell_no_scale_from_an_offset() -> None:
    near = [replace(each, true_m=1 + each.true_m / 20) for each in placements()]
    with pytest.raises(CalibrationError, match=r"1\.5 times as far as the nearest"):
        fit_site(near)


def test_a_mistyped_distance_is_a_contradiction_and_is_named() -> None:
    wrong = placements()
    wrong[3] = replace(wrong[3], read_m=wrong[3].read_m + 0.2)
    fit, right = fit_site(wrong), fit_site(placements())
    assert not fit.is_consistent
    assert fit.worst == 3
    assert fit.scale_sigma > 5 * right.scale_sigma


def test_readings_give_their_median_and_their_scatter() -> None:
    rng = np.random.default_rng(5)
    readings = rng.normal(1.01, 0.001, 200).tolist()
    readings[7] = 3.0
    read = read_placement(replace(UNREAD, frames=200, found=200), seen(readings), 0.1)
    assert read.read_m == pytest.approx(1.01, abs=0.0003)
    assert 0.1 < read.spread_m < 0.2, "an outlier counts for the scatter, and not for where it is"
    assert read.edge_m == pytest.approx(-2 * 0.1 / 60)


def test_a_target_that_moved_meanwhile_is_refused() -> None:
    with pytest.raises(CalibrationError, match=r"at 1 m the distance changed by 2\.0 cm meanwhile"):
        read_placement(UNREAD, seen([1.0] * 20 + [1.02] * 20), 0.1)


def test_noise_with_a_memory_leaves_the_median_less_sure() -> None:
    rng = np.random.default_rng(9)
    fresh = rng.normal(0, 0.001, 400)
    slow = np.zeros(400)
    for at in range(1, 400):
        slow[at] = 0.8 * slow[at - 1] + 0.6 * fresh[at]
    many = replace(UNREAD, frames=400, found=400)
    sure, unsure = (read_placement(many, seen((1 + each).tolist(), 1e-6), 0.1) for each in (fresh, slow))
    # (1 + r) / (1 - r) = 9 for r = 0.8: three times the standard deviation of independent readings.
    assert unsure.read_sigma_m / unsure.spread_m == pytest.approx(3 * sure.read_sigma_m / sure.spread_m, rel=0.3)


def test_the_smallest_error_that_is_found_is_what_leaves_the_interval_in_95_of_100_cases() -> None:
    fit = fit_site(placements())
    readings = np.random.default_rng(4).normal(fit.least_scale, fit.scale_sigma, 20_000)
    assert np.mean(readings > SIGMAS_95 * fit.scale_sigma) == pytest.approx(0.95, abs=0.006)


def test_what_was_not_measured_is_not_reliable_though_the_model_goes_on() -> None:
    reach = find_reach(placements(), fit_site(placements()))
    assert reach.reliable_m == 4.0
    assert reach.limit == "nothing was measured beyond"


def test_reliable_ends_where_the_error_is_a_tenth() -> None:
    noisy = placements(noise_m=0.03)
    reach = find_reach(noisy, fit_site(noisy))
    assert SIGMAS_95 * 0.03 * reach.reliable_m == pytest.approx(0.1, rel=0.05)
    assert "more than 10%" in reach.limit


def test_reliable_ends_where_the_target_is_seen_too_rarely() -> None:
    rare = placements()
    rare[-1] = replace(rare[-1], found=30)
    reach = find_reach(rare, fit_site([each for each in rare if each.is_read]))
    # From 100 % at 3 m to 60 % at 4 m.
    assert reach.reliable_m == pytest.approx(3 + (1 - RELIABLE_RATE) / 0.4, rel=0.02)
    assert "fewer than 95% of frames" in reach.limit


def test_a_target_too_large_for_the_picture_when_near_is_reliable_from_farther_on() -> None:
    large = placements()
    large[0] = replace(large[0], found=0)
    reach = find_reach(large, fit_site(large[1:]))
    assert (reach.nearest_m, reach.reliable_m) == (1.0, 4.0)


def test_of_sites_of_the_error_model_the_truth_is_within_the_interval_as_often_as_stated() -> None:
    sites = [draw_site(seed, is_large=bool(seed % 2)) for seed in range(100)]
    # 95 of 100, less three standard deviations of a count.
    assert all(share >= 0.95 - 3 * math.sqrt(0.95 * 0.05 / 100) for share in covered(sites).values())


def test_of_large_targets_every_error_of_the_scale_from_the_limit_on_is_found() -> None:
    sites = [draw_site(1000 + seed, is_large=True) for seed in range(60)]
    assert all(claims(sites, MIN_FOUND))
    wrongly = claims([draw_site(2000 + seed, is_right=True, is_large=True) for seed in range(60)])
    assert sum(wrongly) <= 9  # 3 are expected, and 9 are three standard deviations more
