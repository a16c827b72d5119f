"""Circles of edges anywhere in a picture: where a ball of unknown colour may be.

Each strong edge votes for the centres that lie along its gradient, to both sides (the Hough transform with gradients:
C. Kimme, D. Ballard and J. Sklansky, 1975). Each level of a picture pyramid has votes for one octave of radii, so that
cells and the number of votes fit the size of the circle, and the grain of a floor is averaged out for larger balls.
The highest counts are fitted to their edges and ranked by how many directions show one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np

from stadimeter.core.detection import Profiles, Values
from stadimeter.core.frame import Image
from stadimeter.detectors.ball.blobs import thin_out
from stadimeter.detectors.ball.circles import ImageCircle

# Longer side to which the picture is reduced, at most, and the shorter side of the last level.
VOTING_WIDTH_PX, MIN_LEVEL_PX = 320, 24

# Share of the pixels that vote, and least steepness of their edges, in levels of 8 bits a pixel.
VOTING_SHARE, MIN_STEEPNESS = 0.08, 1.5

# Radii in pixels of a level: an octave.
RADII_PX = np.array([5.0, 5.75, 6.6, 7.6, 8.7], np.float32)

# Half the side of the square whose votes are what chance brings.
AROUND = 9

# Numbers of counts taken of each radius, fitted of each level, and of circles returned.
PEAKS, MAX_FITTED, MAX_PROPOSED = 2, 6, 4

# An edge is on a circle if its gradient is this near to radial (a cosine), and it is this near to it, in pixels of the
# level and as a share of the radius: first, and once the circle is fitted.
RADIAL, NEAR_PX, NEAR_SHARES = 0.92, 0.5, (0.14, 0.04)

# Directions from the centre in which edges are counted, and the least number of them.
SECTORS, MIN_SECTORS = 24, 9

# Circles with their centres nearer than this share of the radius and with radii as alike are the same one.
SAME_SHARE = 0.3


class _Edges(NamedTuple):
    """Edges of a level, shape ``(n,)`` each: places, and directions of their gradients of length 1."""

    x: Profiles
    y: Profiles
    across: Profiles
    down: Profiles


def propose_circles(image: Image, min_radius_px: float, max_radius_px: float) -> list[ImageCircle]:
    """Return the circles that are most like an outline, the best first, `MAX_PROPOSED` at most."""
    ranked = sorted(_rank_levels(image), key=lambda each: -each[0])
    found: list[ImageCircle] = []
    for _, circle in ranked:
        if min_radius_px <= circle.radius_px <= max_radius_px and not any(are_same(circle, each) for each in found):
            found.append(circle)
    return found[:MAX_PROPOSED]


def _rank_levels(image: Image) -> Iterator[tuple[float, ImageCircle]]:
    """Yield the circles of each level and how much they are like an outline."""
    # Leaving out pixels first costs less than their mean, which the next halving takes.
    step = max(1, max(image.shape[:2]) // (2 * VOTING_WIDTH_PX))
    level = np.asarray(cv2.cvtColor(thin_out(image, step), cv2.COLOR_BGR2GRAY), np.uint8)
    while min(level.shape) >= MIN_LEVEL_PX:
        if max(level.shape) <= VOTING_WIDTH_PX:
            edges = _find_edges(level)
            if len(edges.x) >= MIN_SECTORS:
                circles, likeness = _fit(edges, _highest(edges, level.shape))
                # Pixels of a level are the means of `step` by `step` others.
                off_px = (step - 1) / 2
                for (x, y, radius), like in zip(circles.tolist(), likeness.tolist(), strict=True):
                    yield (
                        like,
                        ImageCircle(x_px=x * step + off_px, y_px=y * step + off_px, radius_px=radius * step),
                    )
        level = level[: level.shape[0] // 2 * 2, : level.shape[1] // 2 * 2]
        size, step = (level.shape[1] // 2, level.shape[0] // 2), 2 * step
        level = np.asarray(cv2.resize(level, size, interpolation=cv2.INTER_AREA), np.uint8)


def _find_edges(grey: Image) -> _Edges:
    """Return the strongest edges of a level, each where it is steepest."""
    gx, gy = cv2.spatialGradient(grey)
    across, down = gx.ravel().astype(np.float32), gy.ravel().astype(np.float32)
    squared = across * across + down * down
    width = grey.shape[1]
    squared[:width] = squared[-width:] = 0
    # Three pixels across each edge are steep; one of them is the steepest. Sobel's sums are eight times the steepness.
    some = squared[::5]
    rank = int(len(some) * (1 - 3 * VOTING_SHARE))
    limit = max(float(np.partition(some, rank)[rank]), (8 * MIN_STEEPNESS) ** 2)
    at = np.flatnonzero(squared > limit)
    beside = np.where(np.abs(across[at]) > np.abs(down[at]), 1, width)
    here = squared[at]
    at = at[(here >= squared[at - beside]) & (here > squared[(at + beside) % len(squared)])]
    per_length = (1 / np.sqrt(squared[at])).astype(np.float32)
    y, x = np.divmod(at, width)
    return _Edges(x.astype(np.float32), y.astype(np.float32), across[at] * per_length, down[at] * per_length)


def _highest(edges: _Edges, shape: tuple[int, ...]) -> Profiles:
    """Return the circles with the most votes as x, y, radius, shape ``(m, 3)``."""
    (height, width), count = shape[:2], len(RADII_PX)
    reach = np.concatenate([RADII_PX, -RADII_PX])[:, None]
    x, y = np.rint(edges.x + reach * edges.across), np.rint(edges.y + reach * edges.down)
    inside = (x >= 0) & (y >= 0) & (x < width) & (y < height)
    band = np.tile(np.arange(count, dtype=np.float32), 2)[:, None]
    cells = ((y * width + x) * count + band)[inside].astype(np.intp)
    # The radii of one place lie next to each other.
    votes = np.bincount(cells, minlength=count * width * height).reshape(height, width, count).astype(np.float32)
    sums = cv2.blur(votes, (3, 3)).reshape(votes.shape)
    # What the middle radius shows around there is expected of all; its root is the standard deviation of counts.
    usual = cv2.blur(cv2.extractChannel(sums, count // 2), (2 * AROUND + 1, 2 * AROUND + 1))
    worth = (sums - usual[..., None]) * (1 / np.sqrt(usual + 0.1))[..., None]
    found = []
    for index, radius in enumerate(RADII_PX.tolist()):
        grid = cv2.extractChannel(worth, index)
        for _ in range(PEAKS):
            _, most, _, (column, row) = cv2.minMaxLoc(grid)
            found.append((most, column, row, radius))
            grid[max(0, row - 2) : row + 3, max(0, column - 2) : column + 3] = 0
    found.sort(reverse=True)
    return np.array(found, np.float32)[:MAX_FITTED, 1:]


def _fit(edges: _Edges, circles: Profiles) -> tuple[Values, Values]:
    """Return circles fitted to the edges near them, and how much each is like an outline."""
    for share in NEAR_SHARES:
        x, y = edges.x - circles[:, :1], edges.y - circles[:, 1:2]
        apart = np.sqrt(x * x + y * y) + np.float32(1e-6)
        near = np.abs(apart - circles[:, 2:]) < share * circles[:, 2:] + NEAR_PX
        on_it = near & (np.abs(x * edges.across + y * edges.down) > RADIAL * apart)
        circles = np.array([_fit_one(*each) for each in zip(circles, x, y, on_it, strict=True)], np.float32)
    row, column = np.nonzero(on_it)
    turns = np.arctan2(y[row, column], x[row, column]) / (2 * np.pi) + 0.5
    cells = row * SECTORS + (turns * SECTORS).astype(np.intp) % SECTORS
    seen = (np.bincount(cells, minlength=len(circles) * SECTORS).reshape(-1, SECTORS) > 0).sum(axis=1)
    radial = on_it.sum(axis=1) / np.maximum(near.sum(axis=1), 1)
    return circles.astype(np.float64), np.where(seen >= MIN_SECTORS, seen * radial, 0.0)


def _fit_one(circle: Profiles, x: Profiles, y: Profiles, on_it: Values) -> Profiles:
    """Fit a circle to edges by the least squares of ``x² + y² = a x + b y + c`` (I. Kåsa, 1976)."""
    x, y = x[on_it], y[on_it]
    if len(x) < MIN_SECTORS // 2:
        return circle
    design = np.stack([x, y, np.ones_like(x)]).astype(np.float64)
    a, b, c = np.linalg.solve(design @ design.T + 1e-3 * np.eye(3), design @ (x * x + y * y))
    radius = np.sqrt(max(c + (a * a + b * b) / 4, 1.0))
    return np.array([circle[0] + a / 2, circle[1] + b / 2, radius], np.float32)


def are_same(one: ImageCircle, other: ImageCircle) -> bool:
    """Return whether two circles are of one outline."""
    off_px = max(abs(one.x_px - other.x_px), abs(one.y_px - other.y_px), abs(one.radius_px - other.radius_px))
    return off_px < SAME_SHARE * max(one.radius_px, other.radius_px)
