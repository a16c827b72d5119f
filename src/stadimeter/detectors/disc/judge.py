"""Tests that distinguish the outline of a disc from other outlines."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from stadimeter.detectors.disc.edges import EllipseEdges
from stadimeter.detectors.sampling import CODES, Light

GREATEST_TILT_RAD = math.radians(75)
"""A disc turned away further from the line of sight is not accepted: it would be seen at a fourth of its height."""

LEAST_CONTRAST = 8.0
"""Least contrast of a disc, in levels of 8 bits, on nine tenths of its outline."""

LEAST_SUPPORT = 0.6
WIDEST_GAP = 0.36
"""Least share of the outline that is seen, and greatest share hidden in one place, such as by a finger."""

SCATTER_PX, SCATTER_BLURS, SCATTER_SHARE = 0.15, 0.15, 0.004
"""Edges may scatter about the ellipse by the sum of these: pixels, widths of the edge, and shares of the diameter."""

BEND_PX, BEND_SHARE = 0.12, 0.003
"""The outline may differ from an ellipse by the sum of these pixels and share of the diameter: an octagon does by
1.1 % of its diameter, a regular polygon of twelve corners by 0.5 %."""

MOST_UNEVEN = 0.12
"""The light inside may differ from that along the rim by this share of the contrast: that of a ball does by more."""

MOST_BLURRED = 0.18
"""Greatest blur of the edge, as a share of the smaller diameter: a glow without an edge is no disc."""


LEAST_HEIGHT = 0.6
"""The least smaller diameter, as a share of the least larger one: the end of a bar looks like an ellipse."""


class Trouble(NamedTuple):
    """Why an outline is not that of a disc."""

    passed: int  # how many tests it passed before
    text: str  # the test that it failed, with the figure and the limit


def trouble_with(edges: EllipseEdges, least_px: float, light: Light) -> Trouble | None:
    """Return the first test of a disc that an outline failed; None if it is a disc, as far as a picture tells."""
    larger, smaller = diameters_px(edges)
    flattest = math.cos(GREATEST_TILT_RAD)
    weakest = levels_out(edges, light) * edges.weakest / max(abs(edges.contrast), 1e-9)
    scatter_px, bend_px = most_scatter_px(edges), BEND_PX + BEND_SHARE * larger
    tests = (
        (
            edges.support >= LEAST_SUPPORT,
            f"has an edge on {edges.support:.0%} of its outline, limit {LEAST_SUPPORT:.0%}",
        ),
        (
            edges.scatter_px <= scatter_px,
            f"is no ellipse: its edge scatters by {edges.scatter_px:.2f} px, limit {scatter_px:.2f} px",
        ),
        (
            edges.bend_px <= bend_px,
            f"is no ellipse: its outline differs from one by {edges.bend_px:.2f} px, limit {bend_px:.2f} px",
        ),
        (
            edges.widest_gap <= WIDEST_GAP,
            f"lacks {edges.widest_gap:.0%} of its outline in one piece, limit {WIDEST_GAP:.0%}",
        ),
        (smaller >= flattest * larger, f"is {smaller / larger:.2f} times as high as wide, limit {flattest:.2f}"),
        (weakest >= LEAST_CONTRAST, f"stands out by {weakest:.0f} levels, limit {LEAST_CONTRAST:.0f}"),
        (
            edges.edge_px <= MOST_BLURRED * smaller,
            f"has an edge blurred over {edges.edge_px:.1f} px, limit {MOST_BLURRED * smaller:.1f} px",
        ),
        (
            edges.unevenness <= MOST_UNEVEN,
            f"is unevenly bright: by {edges.unevenness:.0%} of its contrast, limit {MOST_UNEVEN:.0%}",
        ),
        (
            smaller >= LEAST_HEIGHT * least_px,
            f"is too thin: {smaller:.1f} px, limit {LEAST_HEIGHT * least_px:.1f} px",
        ),
        (larger >= least_px, f"is too small: {larger:.1f} px, limit {least_px:g} px"),
    )
    return next((Trouble(number, text) for number, (passed, text) in enumerate(tests) if not passed), None)


def most_scatter_px(edges: EllipseEdges) -> float:
    """Return by how much the edges of a disc may scatter about its ellipse."""
    return SCATTER_PX + SCATTER_BLURS * edges.edge_px + SCATTER_SHARE * diameters_px(edges)[0]


def diameters_px(edges: EllipseEdges) -> tuple[float, float]:
    """Return the larger and the smaller diameter."""
    larger, smaller, _ = edges.ellipse.axes()
    return 2 * larger, 2 * smaller


def levels_out(edges: EllipseEdges, light: Light) -> float:
    """Return by how many levels of 8 bits a disc stands out: what is seen of it goes with these, not with the light."""
    inside, outside = np.interp((edges.inside, edges.outside), light, np.arange(CODES))
    return abs(float(inside - outside))


def quality(edges: EllipseEdges) -> float:
    """Return how much an outline looks like that of a disc: from 0 to 1."""
    return edges.support * (1 - edges.unevenness / MOST_UNEVEN) * (1 - edges.scatter_px / most_scatter_px(edges) / 2)


def prominence(edges: EllipseEdges, light: Light) -> float:
    """Return how much a disc stands out among others.

    That is the root of contrast times size, since the disc is not always the largest thing, times how round it appears,
    since who measures a disc turns it about towards the camera, times how like a disc it is.
    """
    larger, smaller = diameters_px(edges)
    return math.sqrt(levels_out(edges, light) * larger) * (smaller / larger) * quality(edges)
