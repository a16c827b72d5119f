"""The four sides of a candidate, measured at full resolution: straight lines through the steps in brightness.

The lines do not depend on how the candidate was found: they are fitted again from where the last fit ended until the
same steps are used, so another version of OpenCV, which may round a contour differently, gives the same corners.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from stadimeter.core.frame import Image
from stadimeter.detectors.sampling import sample

CORNER_SHARE = 0.08
"""Share of a side left out at each end: corners are bent, torn or rounded."""

DIFFERENCE_TO_SIGMA = 0.954
"""The median difference of two samples of the same normal noise, as a multiple of its standard deviation."""

OUTLIER_PX = 1.5
OUTLIER_SHARE = 0.02
"""Steps further from the line than 1.5 px, or three times their usual distance, do not belong to the side; but paper
never bends by more than two per cent of a side, so steps further away than that never do."""

LEAST_FIRST_SUPPORT = 0.3
"""A candidate is given up where a side finds so few steps at the first look: most are clutter, and looking is slow."""


@dataclass(frozen=True, slots=True, kw_only=True)
class QuadEdges:
    """What the four sides of a candidate look like. Side i leads from corner i to corner i + 1.

    Attributes:
        corners_px: Where the lines through the sides meet, shape ``(4, 2)``.
        contrast: How much brighter the inside of each side is, in levels of 8 bits, shape ``(4,)``; negative if darker.
        noise: Standard deviation of a pixel beside the sides, in levels.
        support: The share of each side where there is a step on the line, shape ``(4,)``.
        scatter_px: Standard deviation of the steps about each line, shape ``(4,)``.
        steps: How many steps each line was fitted to, shape ``(4,)``.
    """

    corners_px: Points
    contrast: NDArray[np.float64]
    noise: float
    support: NDArray[np.float64]
    scatter_px: NDArray[np.float64]
    steps: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class _Levels:
    """How bright it is on both sides of an edge, away from the edge itself.

    Attributes:
        contrast: How much brighter the inside is, for each channel.
        noise: Standard deviation of a sample.
    """

    contrast: NDArray[np.float64]
    noise: float


@dataclass(frozen=True, slots=True)
class _Profiles:
    """Brightness across one side, from the inside to the outside.

    Attributes:
        length_px: Length of the side.
        along_px: How far along the side each profile stands, shape ``(n,)``.
        across_px: How far outside each sample lies, shape ``(k,)``.
        values: The samples, shape ``(n, k, channels)``.
    """

    length_px: float
    along_px: Points
    across_px: Points
    values: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class _Line:
    """The line through one side, in the coordinates of its profiles: across = offset + slope * along."""

    offset_px: float
    slope: float
    support: float
    scatter_px: float
    steps: int


def measure_edges(image: Image, corners_px: Points, reach_px: float, free_sides: tuple[bool, ...]) -> QuadEdges | None:
    """Fit lines to the sides of a candidate.

    Args:
        image: The picture at full resolution, three channels.
        corners_px: The candidate's corners, clockwise on the screen, shape ``(4, 2)``.
        reach_px: How far from the candidate's sides the true ones may be.
        free_sides: For each side, whether it is not one; such a side stays as it is, as where the border cuts it.

    Returns:
        The sides; or None where the lines form no outline near the candidate.
    """
    channel = _clearest_channel(image, corners_px, reach_px, free_sides)
    plane = image[:, :, channel : channel + 1]
    edges = None
    for reach in (reach_px, reach_px, max(3.0, reach_px / 2), max(3.0, reach_px / 2)):
        edges = _fit_once(plane, corners_px, reach, free_sides)
        if edges is None or edges.support.min() < LEAST_FIRST_SUPPORT:
            return None
        if np.abs(edges.corners_px - corners_px).max() > 4 * reach_px:
            return None
        corners_px = edges.corners_px
    return edges


def _clearest_channel(image: Image, corners: Points, reach_px: float, free_sides: tuple[bool, ...]) -> int:
    """Return the channel in which the side that stands out least stands out most."""
    contrasts = np.array(
        [
            _levels(_profiles(image, corners, side, reach_px), reach_px).contrast
            for side in range(4)
            if not free_sides[side]
        ]
    )
    one_sign = np.where(np.abs(np.sign(contrasts).sum(axis=0)) == len(contrasts), 1.0, 0.1)
    return int(np.argmax(np.abs(contrasts).min(axis=0) * one_sign))


def _fit_once(plane: Image, corners: Points, reach_px: float, free_sides: tuple[bool, ...]) -> QuadEdges | None:
    profiles = [_profiles(plane, corners, side, reach_px) for side in range(4)]
    levels = [_levels(each, min(reach_px, 3.0)) for each in profiles]
    contrast = np.array([float(each.contrast[0]) for each in levels])
    polarity = _polarity(contrast[~np.array(free_sides)])
    lines = [
        _Line(0.0, 0.0, 1.0, 0.0, 0) if free_sides[side] else _fit_line(profiles[side], polarity) for side in range(4)
    ]
    met = _intersections(corners, lines)
    if met is None:
        return None
    return QuadEdges(
        corners_px=met,
        contrast=contrast,
        noise=float(np.median([each.noise for each in levels])),
        support=np.array([line.support for line in lines]),
        scatter_px=np.array([line.scatter_px for line in lines]),
        steps=np.array([line.steps for line in lines]),
    )


def _polarity(contrast: NDArray[np.float64]) -> float:
    """Return 1 for a sheet that is brighter than what is behind it, -1 for a darker one."""
    return 1.0 if float(np.median(contrast)) >= 0 else -1.0


def _profiles(image: Image, corners: Points, side: int, reach_px: float) -> _Profiles:
    start, end = corners[side], corners[(side + 1) % 4]
    length = float(np.hypot(*(end - start)))
    direction = (end - start) / max(length, 1e-9)
    outward = np.array([direction[1], -direction[0]])
    count = int(np.clip(length / 2, 8, 64))
    along = np.linspace(CORNER_SHARE, 1 - CORNER_SHARE, count) * length
    across = np.arange(-reach_px - 3.0, reach_px + 3.01, 0.5)
    points = start + along[:, None, None] * direction + across[None, :, None] * outward
    return _Profiles(length, along, across, sample(image, points[..., 0], points[..., 1]))


def _levels(profiles: _Profiles, gap_px: float) -> _Levels:
    """Return how bright it is on both sides, further from the candidate's side than the gap."""
    beyond = min(gap_px, float(profiles.across_px[-1]) - 1.0)
    inside = np.median(profiles.values[:, profiles.across_px <= -beyond], axis=(0, 1))
    outside = np.median(profiles.values[:, profiles.across_px >= beyond], axis=(0, 1))
    differences = np.abs(np.diff(profiles.values[:, ::4], axis=1))
    return _Levels(np.asarray(inside - outside, np.float64), float(np.median(differences)) / DIFFERENCE_TO_SIGMA)


def _fit_line(profiles: _Profiles, polarity: float) -> _Line:
    """Fit a line to the steepest steps, by weighted least squares with Tukey's weights from a median start."""
    across, height = _steepest_steps(profiles, polarity)
    along = profiles.along_px
    strong = height > max(0.3 * float(np.median(height)), 1e-6)
    if strong.sum() < 4:
        return _Line(0.0, 0.0, 0.0, 0.0, 0)
    offset, slope = _median_line(along[strong], across[strong])
    limit = OUTLIER_PX
    for _ in range(5):
        residual = across - offset - slope * along
        spread = 1.4826 * float(np.median(np.abs(residual[strong])))
        limit = max(OUTLIER_PX, min(3 * spread, OUTLIER_SHARE * profiles.length_px))
        weight = np.where(strong & (np.abs(residual) < limit), (1 - (residual / limit) ** 2) ** 2, 0.0)
        if (weight > 0).sum() < 4:
            return _Line(0.0, 0.0, 0.0, 0.0, 0)
        offset, slope = _weighted_line(along, across, weight)
    residual = across - offset - slope * along
    near = strong & (np.abs(residual) < limit)
    return _Line(offset, slope, float(near.mean()), float(np.std(residual[near])), int(near.sum()))


def _steepest_steps(profiles: _Profiles, polarity: float) -> tuple[Points, Points]:
    """Return for each profile where it falls most steeply from the inside to the outside, and how much in a pixel."""
    values = profiles.values[:, :, 0]
    beside = np.pad(values, ((1, 1), (0, 0)), mode="edge")
    smooth = (beside[:-2] + 2 * beside[1:-1] + beside[2:]) / 4
    fall = polarity * (smooth[:, :-4] - smooth[:, 4:]) / 2
    best = np.clip(np.argmax(fall, axis=1), 1, fall.shape[1] - 2)
    rows = np.arange(len(fall))
    before, peak, after = fall[rows, best - 1], fall[rows, best], fall[rows, best + 1]
    curvature = before - 2 * peak + after
    shift = np.where(curvature < -1e-6, 0.5 * (before - after) / np.where(curvature < -1e-6, curvature, 1.0), 0.0)
    step_px = float(profiles.across_px[1] - profiles.across_px[0])
    across = profiles.across_px[best + 2] + np.clip(shift, -1, 1) * step_px
    return np.asarray(across, np.float64), np.asarray(peak, np.float64)


def _median_line(along: Points, across: Points) -> tuple[float, float]:
    """Return the line of Theil and Sen: the median of the slopes between all points, which outliers do not move."""
    first, second = np.triu_indices(len(along), k=max(1, len(along) // 4))
    slope = float(np.median((across[second] - across[first]) / (along[second] - along[first])))
    return float(np.median(across - slope * along)), slope


def _weighted_line(along: Points, across: Points, weight: Points) -> tuple[float, float]:
    total = weight.sum()
    mean_along, mean_across = (weight * along).sum() / total, (weight * across).sum() / total
    spread = (weight * (along - mean_along) ** 2).sum()
    slope = (weight * (along - mean_along) * (across - mean_across)).sum() / max(spread, 1e-9)
    return float(mean_across - slope * mean_along), float(slope)


def _intersections(corners: Points, lines: list[_Line]) -> Points | None:
    """Return the corners between neighbouring lines, or None where two of them are all but parallel."""
    homogeneous = []
    for side, line in enumerate(lines):
        start, end = corners[side], corners[(side + 1) % 4]
        direction = (end - start) / max(float(np.hypot(*(end - start))), 1e-9)
        outward = np.array([direction[1], -direction[0]])
        point = start + line.offset_px * outward
        along = direction + line.slope * outward
        normal = np.array([along[1], -along[0]]) / float(np.hypot(*along))
        homogeneous.append(np.array([normal[0], normal[1], -float(normal @ point)]))
    met = []
    for side in range(4):
        crossing = np.cross(homogeneous[side - 1], homogeneous[side])
        if abs(crossing[2]) < 0.1:
            return None
        met.append(crossing[:2] / crossing[2])
    return np.array(met)
