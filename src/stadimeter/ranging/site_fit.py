"""Accuracy of distances at one place: from a target at taped distances, by weighted least squares.

A target is put at some distances D_i that a tape gives, and at each of them its distance is measured for some seconds.
The readings y_i are taken to be wrong like this:

    y_i - D_i = s D_i + o + b e_i + t_i + z + n_i

=====  ============================================================================================================
s      error of the scale: the focal length or the size of the target is wrong by this share
o      offset: the lens is behind the mark from which the tape measures
b      by how many of its standard deviations the edge bias of the camera file is wrong; e_i is what one does at D_i
t_i    error of putting the target there: independent, the tape's ± as a standard deviation
z      error of the tape's zero: the same at every distance, with the same standard deviation
n_i    noise of the reading: what is left of the scatter from frame to frame, and a part that stays as long as nothing
       moves, since the same pixels see the same edges
=====  ============================================================================================================

s and o are free. b has the prior distribution that the camera file states, so it enters as one more observation. With
all covariances stated, the estimate is the generalised least squares one, and its covariance is the inverse of the
normal matrix. z looks like o, and widens its interval alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.measurement import Measurement
from stadimeter.errors import CalibrationError

Values = NDArray[np.float64]

# Half of the interval that holds 95 % of a normal distribution, in standard deviations.
SIGMAS_95 = 1.96

# An error of the scale of this many standard deviations is found in 95 of 100 cases: so often it leaves that interval.
SIGMAS_FOUND = SIGMAS_95 + 1.645

# An error of the scale from which on it must be found.
WANTED_SCALE = 0.015

# Scale and offset are two unknowns: three placements are the fewest that can contradict themselves.
MIN_PLACEMENTS = 3

# They must span this ratio, or scale and offset cannot be told apart by a tape of millimetres.
MIN_SPAN = 1.5

# With fewer readings there is no scatter to speak of; and a target that is found less often may be something else.
MIN_READINGS, MIN_FOUND_SHARE = 5, 0.5

# The part of the stated noise that does not average out while nothing moves. Over rendered placements from 0.3 to 6 m
# its rms was 0.39 to 0.45 for balls; 0.83 for tags and 1.06 for sheets, whose noise is far below any tape's.
LASTING_SHARE = 0.5

# A target has moved if both halves of its readings differ by more than this many standard errors, this share of the
# distance, and this many times the stated noise: noise with a long memory wanders, but hardly ever as far as that.
MOVED_SIGMAS, MOVED_SHARE, MOVED_NOISES = 5.0, 0.003, 1.5

# A distance can be relied on while its error is within this share in 95 of 100 frames, and as many show the target.
RELIABLE_SHARE, RELIABLE_RATE = 0.1, 0.95


class Placement(Struct, frozen=True, kw_only=True):
    """The sightings of a target at one taped distance. The figures are 0 where it was not seen often enough.

    Attributes:
        tape_m: By the tape: from the lens to the target's nearest point.
        true_m: The same to its centre.
        tape_sigma_m: The tape's standard deviation.
        read_m: The median of the measured distances.
        read_sigma_m: Its standard deviation, without the tape's.
        spread_m: The standard deviation of the measured distance from frame to frame.
        noise_m: The same with what stays while nothing moves: how one reading scatters around the truth.
        stated_m: The standard deviation that the measurements themselves state.
        edge_m: By how much one standard deviation of the edge bias changes the distance.
        reason: Why the target was not found in the first frame without it.
    """

    tape_m: float
    true_m: float
    tape_sigma_m: float
    frames: int = 0
    found: int = 0
    read_m: float = 0.0
    read_sigma_m: float = 0.0
    spread_m: float = 0.0
    noise_m: float = 0.0
    stated_m: float = 0.0
    edge_m: float = 0.0
    size_px: float = 0.0
    reason: str = ""

    @property
    def is_read(self) -> bool:
        """True if it was seen often enough to say where it is."""
        return self.found >= max(MIN_READINGS, MIN_FOUND_SHARE * self.frames)


def read_placement(placed: Placement, seen: Sequence[Measurement], edge_sigma_px: float) -> Placement:
    """Return a placement with what was measured there.

    Args:
        placed: Where it was put, how many frames there were, and how large it appeared.
        seen: The measurements that have a distance, in the order of the frames.
        edge_sigma_px: The standard deviation of the edge bias, in pixels of those frames.

    Raises:
        CalibrationError: It moved meanwhile.
    """
    if not placed.is_read:
        return placed
    distances_m, sigmas_m, noises_m = np.array([(each.distance_m, each.sigma_m, each.noise_m) for each in seen]).T
    half = len(seen) // 2
    before_m, after_m = np.median(distances_m[:half]), np.median(distances_m[half:])
    around_m = np.append(distances_m[:half] - before_m, distances_m[half:] - after_m)
    step_m = float(abs(after_m - before_m))
    allowed_m = MOVED_SIGMAS * float(around_m.std()) * math.sqrt(4 / _independent(around_m))
    if step_m > max(MOVED_SHARE * placed.true_m, MOVED_NOISES * float(np.median(noises_m)), allowed_m):
        raise CalibrationError(
            f"at {placed.tape_m:g} m the distance changed by {100 * step_m:.1f} cm meanwhile: keep the target"
            " and the camera still, and lock the focus if the camera lets you"
        )
    read_m, spread_m = float(np.median(distances_m)), float(distances_m.std(ddof=1))
    lasting_m = LASTING_SHARE * float(np.median(noises_m))
    # The median of normal readings scatters by √(π/2) of what their mean does.
    median_m = math.sqrt(math.pi / 2 / _independent(distances_m - read_m)) * spread_m
    return replace(
        placed,
        read_m=read_m,
        read_sigma_m=math.hypot(lasting_m, median_m),
        spread_m=spread_m,
        noise_m=math.hypot(spread_m, lasting_m),
        stated_m=float(np.median(sigmas_m)),
        # Both edges move outwards, so the size grows by twice the bias, and the distance shrinks by that share.
        edge_m=-2 * edge_sigma_px / placed.size_px * placed.true_m,
    )


def _independent(around: Values) -> float:
    """Return the number of independent readings that say as much as these, of which neighbours may be alike.

    For noise whose correlation falls by the same factor r from one frame to the next it is n (1 - r) / (1 + r). The
    estimate of r is too small by (1 + 3 r) / n (M. G. Kendall, Biometrika 41, 1954).
    """
    count = len(around)
    alike = float(around[1:] @ around[:-1]) / max(float(around @ around), 1e-300)
    alike = min(max(alike + (1 + 3 * alike) / count, 0.0), 0.95)
    return max(1.0, count * (1 - alike) / (1 + alike))


class SiteFit(Struct, frozen=True, kw_only=True):
    """The errors of the distances of a site, and how sure they are.

    Attributes:
        scale: The share by which distances are too long.
        edge: By how many of its standard deviations the edge bias of the camera file is wrong.
        covariance: Of scale, offset and edge.
        edge_per_m: By how much one standard deviation of the edge bias changes a distance, over its square.
        is_consistent: Whether the placements agree with each other; if not, all standard deviations were enlarged.
        worst: The number of the placement that fits the others worst.
        has_wrong_scale: Whether the scale is off by more than chance explains.
        has_offset: Whether the offset is.
    """

    scale: float
    scale_sigma: float
    offset_m: float
    offset_sigma_m: float
    edge: float
    covariance: list[list[float]]
    edge_per_m: float
    is_consistent: bool
    worst: int
    has_wrong_scale: bool
    has_offset: bool

    @property
    def least_scale(self) -> float:
        """The smallest error of the scale that it finds in 95 of 100 cases."""
        return SIGMAS_FOUND * self.scale_sigma

    def bias_m(self, distance_m: float) -> tuple[float, float]:
        """Return by how much a distance is measured too long on average, and the standard deviation of that."""
        design = np.array([distance_m, 1.0, self.edge_per_m * distance_m**2])
        bias_m = float(design @ [self.scale, self.offset_m, self.edge])
        return bias_m, math.sqrt(float(design @ np.array(self.covariance) @ design))


def fit_site(placements: Sequence[Placement]) -> SiteFit:
    """Find what is wrong with the distances, from placements that are all read.

    Raises:
        CalibrationError: There are too few, or they are too near to each other.
    """
    figures = [(each.true_m, each.read_m, each.edge_m, each.read_sigma_m, each.tape_sigma_m) for each in placements]
    if len(figures) < MIN_PLACEMENTS or max(figures)[0] < MIN_SPAN * min(figures)[0]:
        raise CalibrationError(
            f"the target was seen at {len(figures)} distances: {MIN_PLACEMENTS} or more are needed, the farthest"
            f" {MIN_SPAN:g} times as far as the nearest"
        )
    true_m, read_m, edge_m, read_sigma_m, tape_m = np.array(figures).T
    # Weighted by 1/σ, each row has the variance 1; the last one is the prior of the edge bias: 0 ± 1.
    weight = 1 / np.hypot(read_sigma_m, tape_m)
    design = np.column_stack([true_m, np.ones_like(true_m), edge_m]) * weight[:, None]
    design = np.vstack([design, [0.0, 0.0, 1.0]])
    off = np.append((read_m - true_m) * weight, 0.0)
    covariance = np.linalg.inv(design.T @ design)
    found = covariance @ (design.T @ off)
    residuals = off - design @ found
    # The misfit has a χ² distribution. Its 99th percentile by E. B. Wilson and M. M. Hilferty, PNAS 17, 1931.
    freedom, misfit = len(figures) - 2, float(residuals @ residuals)
    is_consistent = misfit <= freedom * (1 - 2 / (9 * freedom) + 2.3263 * math.sqrt(2 / (9 * freedom))) ** 3
    if not is_consistent:  # some σ is too small, and all grow by what the misfit says
        covariance *= misfit / freedom
    covariance[1, 1] += tape_m.max() ** 2  # the tape's zero
    sigmas = np.sqrt(np.diag(covariance))
    is_beyond = np.abs(found) > SIGMAS_95 * sigmas
    return SiteFit(
        scale=float(found[0]),
        scale_sigma=float(sigmas[0]),
        offset_m=float(found[1]),
        offset_sigma_m=float(sigmas[1]),
        edge=float(found[2]),
        covariance=covariance.tolist(),
        edge_per_m=float(np.mean(edge_m / true_m**2)),
        is_consistent=is_consistent,
        worst=int(np.argmax(np.abs(residuals[:-1]))),
        has_wrong_scale=bool(is_beyond[0]),
        has_offset=bool(is_beyond[1]),
    )


class Reach(Struct, frozen=True, kw_only=True):
    """The range in which distances can be relied on.

    Attributes:
        nearest_m: The nearest distance: 0, or the nearest placement that was seen if it was not seen at a nearer one.
        reliable_m: The farthest distance, none beyond the farthest placement; 0 for nowhere.
        limit: What ends it there.
    """

    nearest_m: float
    reliable_m: float
    limit: str


def noise_at_m(placements: Sequence[Placement], distance_m: float) -> float:
    """Return the scatter of one reading at a distance: as at placements around it, by the square of the distance."""
    read = sorted((each.true_m, each.noise_m / each.true_m**2) for each in placements if each.is_read)
    places_m, per_m = zip(*read, strict=True)
    return float(np.interp(distance_m, places_m, per_m)) * distance_m**2


def find_reach(placements: Sequence[Placement], fit: SiteFit) -> Reach:
    """Find how far the error stays within `RELIABLE_SHARE` and the target is seen in `RELIABLE_RATE` of frames."""
    places_m, rates = zip(*sorted((each.true_m, each.found / each.frames) for each in placements), strict=True)
    read_m = [each.true_m for each in placements if each.is_read]
    last_m, limit = 0.0, "nothing was measured beyond"
    for distance_m in np.geomspace(min(read_m), max(read_m), 400).tolist():
        bias_m, sigma_m = fit.bias_m(distance_m)
        error_m = abs(bias_m) + SIGMAS_95 * math.hypot(sigma_m, noise_at_m(placements, distance_m))
        if np.interp(distance_m, places_m, rates) < RELIABLE_RATE:
            limit = f"it is seen in fewer than {RELIABLE_RATE:.0%} of frames"
        elif error_m > RELIABLE_SHARE * distance_m:
            limit = f"the error is more than {RELIABLE_SHARE:.0%} in 5 of 100 readings"
        else:
            last_m = distance_m
            continue
        break
    nearest_m = min(read_m) if places_m[0] < min(read_m) else 0.0
    return Reach(nearest_m=nearest_m, reliable_m=last_m, limit=limit)
