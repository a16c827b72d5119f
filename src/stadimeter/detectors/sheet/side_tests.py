"""What the four sides of a candidate must be like, whatever its shape: seen, straight, and around one thing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from stadimeter.detectors.sheet.edges import QuadEdges
from stadimeter.detectors.sides import QuadShapes, quad_shapes

Values = NDArray[np.float64]
Which = NDArray[np.bool_]

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


def side_tests(edges: QuadEdges, min_side_px: float) -> tuple[tuple[Which, Callable[[int], str]], ...]:
    """Return tests of the sides: which candidates pass, and what to say of one that does not."""
    shapes = quad_shapes(edges.corners_px)
    # One number for each candidate and test; those that follow are shape (c,) but for `support`, which has the sides.
    contrast, support = edges.colour_contrast.min(axis=1), edges.support
    bends = edges.scatter_px / np.maximum(MAX_BEND_PX, MAX_BEND_SHARE * shapes.sides_px)
    uneven = np.maximum(edges.unevenness.max(axis=1), _imbalance(edges))
    even_limit = even_limits(edges)
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
        (
            bends.max(axis=1) <= 1,
            lambda i: f"bent sides: edge scatters by {bends[i].max():.1f} times the limit",
        ),
        (
            uneven <= even_limit,
            lambda i: f"uneven inside: by {uneven[i]:.0f} levels along its border, limit {even_limit[i]:.0f}",
        ),
    )


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
