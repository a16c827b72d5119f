"""Tests of the four sides of a candidate, and of whether it is rather another paper than the one looked for."""

from __future__ import annotations

import math

import numpy as np

from stadimeter.config.units import PAPER, parse_length
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Points, Values
from stadimeter.detectors.sheet.candidates import Test, seen_sides
from stadimeter.detectors.sheet.edges import QuadEdges
from stadimeter.detectors.sides import QuadShapes, quad_shapes
from stadimeter.ranging.flat import SheetShape

# The share of any side, and of all sides, that must be seen as a straight edge; and of the others where the border cuts
# one. The rest may be hidden by fingers, or lie before something that looks like the sheet.
MIN_SUPPORT = 0.25
MIN_MEAN_SUPPORT = 0.7
MIN_CUT_SUPPORT = 0.85

# Least contrast of each side with what is behind it, in levels of 8 bits of the channel that differs most.
MIN_CONTRAST = 6.0

# Greatest scatter of the edge about a straight line, in pixels or as a share of the side, whatever is more.
MAX_BEND_PX = 0.6
MAX_BEND_SHARE = 0.003

# Greatest difference of the inside along its border, in levels or as a share of the contrast, whatever is more: light
# may fall off across a sheet, but it is one thing.
UNEVEN_LEVELS = 20.0
UNEVEN_SHARE = 0.35


def side_tests(edges: QuadEdges, min_side_px: float) -> tuple[Test, ...]:
    """Return tests of the sides: which candidates pass, and what to say of one that does not."""
    shapes = quad_shapes(edges.corners_px)
    # One number for each candidate and test; those that follow are shape (c,) but for `support`, which has the sides.
    contrast, support = edges.colour_contrast.min(axis=1), edges.support
    return (
        (shapes.shorter_px >= min_side_px, lambda i: small_text(shapes, i, min_side_px)),
        (
            contrast >= MIN_CONTRAST,
            lambda i: f"stands out on its weakest side by {contrast[i]:.0f} levels, limit {MIN_CONTRAST:.0f}",
        ),
        (support.min(axis=1) >= MIN_SUPPORT, lambda i: straight_text(edges, i, MIN_SUPPORT)),
        (
            support.mean(axis=1) >= MIN_MEAN_SUPPORT,
            lambda i: f"{support[i].mean():.0%} of its sides are straight edges, limit {MIN_MEAN_SUPPORT:.0%}",
        ),
    )


def bends(edges: QuadEdges) -> Values:
    """Return the scatter of the most bent side's steps about a straight line, in times the limit, shape ``(c,)``."""
    limits_px = np.maximum(MAX_BEND_PX, MAX_BEND_SHARE * quad_shapes(edges.corners_px).sides_px)
    return np.asarray((edges.scatter_px / limits_px).max(axis=1))


def unevenness(edges: QuadEdges) -> Values:
    """Return the difference of the inside along the border, in times the limit, shape ``(c,)``."""
    uneven = np.maximum(edges.unevenness.max(axis=1), _imbalance(edges))
    return np.asarray(uneven / even_limits(edges))


def even_limits(edges: QuadEdges) -> Values:
    """Return by how many levels the inside may differ along the border."""
    limits: Values = np.maximum(UNEVEN_LEVELS, UNEVEN_SHARE * edges.colour_contrast.max(axis=1))
    return limits


def _imbalance(edges: QuadEdges) -> Values:
    """Return by how many levels the insides differ, other than by light that falls off evenly across."""
    # Light that falls off in one direction makes one side of each pair brighter by as much as the other is darker: the
    # sums of both pairs are then alike, whatever the colour of the sheet.
    across = edges.inside[:, [0, 2]].sum(axis=1) - edges.inside[:, [1, 3]].sum(axis=1)
    imbalance: Values = np.abs(across).max(axis=1) / 2
    return imbalance


def small_text(shapes: QuadShapes, number: int, limit_px: float) -> str:
    """Say how small a candidate is."""
    return f"{shapes.shorter_px[number]:.0f} px wide, limit {limit_px:.0f} px"


def straight_text(edges: QuadEdges, number: int, limit: float) -> str:
    """Say how little of its worst side is seen."""
    return f"a side of which {edges.support[number].min():.0%} is a straight edge, limit {limit:.0%}"


# Two ratios of sides are different, or the same, that differ by more, or less, than this share.
OTHER_SHAPE = 0.04
SAME_SHAPE = 0.02

# Papers whose areas differ by more than this factor, as a logarithm, are not mistaken for each other.
LIKE_IN_SIZE = math.log(1.5)

# Greatest cosine of a corner in space that is a right one.
RIGHT_ANGLE = 0.05

# Opposite sides of a sheet that faces the camera differ by this factor at most.
FACING_RATIO = 1.03

# A sheet has a name if both its sides are those of the paper, to this share.
NAMED = 0.005

_SIDES_M = {name: tuple(sorted(map(parse_length, each))) for name, each in PAPER.items()}


def other_paper(corners_px: Points, size: SheetShape, lens: CameraModel | None) -> str:
    """Say which paper an outline is rather than the sheet: ``sides 1.29 : 1, not 1.41 : 1: letter instead of A4?``.

    Empty where no paper that it may be mistaken for explains it better. Without the lens only what faces the camera
    tells its shape.
    """
    seen = _seen_aspect(corners_px, lens)
    wanted = size.longest_m / size.shortest_m
    if seen is None or _apart(seen, wanted) < OTHER_SHAPE:
        return ""
    alike = [name for name in mistaken_for(size) if _apart(_aspect(_SIDES_M[name]), seen) < SAME_SHAPE]
    return f"sides {seen:.2f} : 1, not {wanted:.2f} : 1: {alike[0]} instead of {_name(size)}?" if alike else ""


def other_shape(corners_px: Points, size: SheetShape, lens: CameraModel | None) -> str:
    """Say which size would fit an outline that is no picture of the sheet; empty where it is no rectangle for sure."""
    seen, wanted = _seen_aspect(corners_px, lens), size.longest_m / size.shortest_m
    if seen is None or _apart(seen, wanted) < OTHER_SHAPE:
        return ""
    long_mm = 1000 * size.longest_m
    fitting = f"sides {seen:.2f} : 1, not {wanted:.2f} : 1; about {long_mm:.0f} x {long_mm / seen:.0f} mm would fit"
    return other_paper(corners_px, size, lens) or fitting


def mistaken_for(size: SheetShape) -> list[str]:
    """Return the papers that a sheet with a name may be mistaken for, the likeliest first; none for any other sheet.

    They are of about its size, but of another shape: one of the same, such as A5 for A4, looks just alike, so it
    explains nothing.
    """
    if not _name(size):
        return []
    off = {name: _apart(each[0] * each[1], size.shortest_m * size.longest_m) for name, each in _SIDES_M.items()}
    own = size.longest_m / size.shortest_m
    others = (name for name, each in _SIDES_M.items() if _apart(_aspect(each), own) >= OTHER_SHAPE)
    return sorted((name for name in others if off[name] < LIKE_IN_SIZE), key=lambda name: off[name])


def _name(size: SheetShape) -> str:
    return next((name for name, each in _SIDES_M.items() if _is_size(each, size)), "")


def _aspect(sides_m: tuple[float, ...]) -> float:
    return sides_m[1] / sides_m[0]


def _seen_aspect(corners_px: Points, lens: CameraModel | None) -> float | None:
    if lens is None:
        shapes = quad_shapes(corners_px[None])
        is_turned = shapes.side_ratio[0] > FACING_RATIO or math.cos(shapes.sharpest_rad[0]) > RIGHT_ANGLE
        return None if is_turned else float(shapes.aspect[0])
    cosine, ratio = seen_sides(lens.directions(corners_px))
    return max(ratio, 1 / ratio) if abs(cosine) < RIGHT_ANGLE and ratio > 0 else None


def _apart(one: float, other: float) -> float:
    return abs(math.log(one / other))


def _is_size(sides_m: tuple[float, ...], size: SheetShape) -> bool:
    return _apart(sides_m[0], size.shortest_m) < NAMED and _apart(sides_m[1], size.longest_m) < NAMED
