"""What hides a part of a target: a board, and a hand."""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from support.scenes.target import Colour, Floats, Layer, Patch
from support.scenes.tone import decode_srgb

# Something in front of the target that hides an exact share of it.

BISECTIONS = 24


class Occluder(Struct, frozen=True, kw_only=True):
    """A board with a straight edge, pushed before the target from one side until it hides its share.

    Attributes:
        share: The share of the target's area in the picture that is hidden, from 0 to 1.
        from_rad: The side that it comes from, as an angle in the picture from right towards down.
        bgr: Its colour.
    """

    share: float
    from_rad: float = 0.0
    bgr: Colour = (70, 74, 82)

    def corners_px(self, outline_px: Points) -> Points:
        """Return its corners: its edge goes through the target, the rest reaches past it on the other three sides.

        Args:
            outline_px: The target's outline, shape ``(n, 2)``, convex and in order around it.

        Returns:
            Shape ``(4, 2)``; the first two are the ends of the edge that hides.
        """
        outwards = np.array((math.cos(self.from_rad), math.sin(self.from_rad)))
        sideways = np.array((-outwards[1], outwards[0]))
        out, side = outline_px @ outwards, outline_px @ sideways
        edge = self._edge(outline_px, outwards)
        reach = 0.3 * max(float(np.ptp(out)), float(np.ptp(side)))
        far, low, high = float(out.max()) + reach, float(side.min()) - reach, float(side.max()) + reach
        places = ((edge, low), (edge, high), (far, high), (far, low))
        return np.array([outwards * along + sideways * across for along, across in places])

    def layer(self, patch: Patch, outline_px: Points) -> Layer:
        """Return what it covers of a patch."""
        corners = self.corners_px(outline_px)
        columns = patch.left + (np.arange((patch.right - patch.left) * patch.finer) + 0.5) / patch.finer - 0.5
        rows = patch.top + (np.arange((patch.bottom - patch.top) * patch.finer) + 0.5) / patch.finer - 0.5
        cover = np.ones((len(rows), len(columns)))
        for side in range(4):
            start, end = corners[side], corners[(side + 1) % 4]
            inwards = np.array((start[1] - end[1], end[0] - start[0])) / np.linalg.norm(end - start)
            if float(inwards @ (corners.mean(axis=0) - start)) < 0:
                inwards = -inwards
            deep = (columns[None, :] - start[0]) * inwards[0] + (rows[:, None] - start[1]) * inwards[1]
            cover *= np.clip(deep * patch.finer + 0.5, 0, 1)
        shape = (*cover.shape, 3)
        return Layer(cover.astype(np.float32), np.broadcast_to(decode_srgb(self.bgr), shape))

    def _edge(self, outline_px: Points, outwards: Floats) -> float:
        """Return how far along ``outwards`` the edge must be so that the share beyond it is hidden."""
        out = outline_px @ outwards
        low, high = float(out.min()), float(out.max())
        whole = _area(outline_px)
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            beyond = _area(_beyond(outline_px, outwards, middle))
            low, high = (middle, high) if beyond > self.share * whole else (low, middle)
        return (low + high) / 2


def _beyond(polygon: Points, outwards: Floats, edge: float) -> Points:
    """Cut off the part of a polygon beyond a line (I. Sutherland and G. Hodgman, 1974)."""
    kept: list[Floats] = []
    depth = polygon @ outwards - edge
    for start, end, first, second in zip(polygon, np.roll(polygon, -1, 0), depth, np.roll(depth, -1), strict=True):
        if first >= 0:
            kept.append(start)
        if (first >= 0) != (second >= 0):
            kept.append(start + (end - start) * first / (first - second))
    return np.array(kept).reshape(-1, 2)


def _area(polygon: Points) -> float:
    if len(polygon) < 3:
        return 0.0
    x, y = polygon[:, 0], polygon[:, 1]
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


# Fingers that hold a ball, before it and around it.

Plane = NDArray[np.float32]

REACH_RADII = 2.6
"""How far out the fingers and the palm reach, in radii of the ball."""


class Hand(Struct, frozen=True, kw_only=True):
    """Rounded fingers from one side, each over a part of the limb.

    Attributes:
        fingers: Number of them.
        from_rad: The side that they come from, from right towards down.
        spread_rad: Angle between the first and the last of them, about the middle of the ball.
        depth: How far they reach over the limb, as a share of the radius.
        width: Half the width of a finger, as a share of the radius.
        bgr: The colour of the skin.
        seed: How they are bent.
    """

    fingers: int = 4
    from_rad: float = 0.0
    spread_rad: float = 1.6
    depth: float = 0.25
    width: float = 0.22
    bgr: Colour = (105, 130, 178)
    seed: int = 0

    def corners_px(self, outline_px: Points) -> Points:
        """Return the corners of a box around the ball and all fingers."""
        centre, radius = _circle(outline_px)
        reach = (REACH_RADII + self.width) * radius
        return centre + np.array([(-reach, -reach), (reach, -reach), (reach, reach), (-reach, reach)])

    def layer(self, patch: Patch, outline_px: Points) -> Layer:
        """Return what the hand covers of a patch, lighter in the middle of each finger than at its sides."""
        (x0, y0), radius = _circle(outline_px)
        x = patch.left + (np.arange((patch.right - patch.left) * patch.finer) + 0.5) / patch.finer - 0.5
        y = patch.top + (np.arange((patch.bottom - patch.top) * patch.finer) + 0.5) / patch.finer - 0.5
        rng = np.random.default_rng((self.seed, 70))
        cover = np.zeros((len(y), len(x)), np.float32)
        light = np.zeros((len(y), len(x), 3), np.float32)
        skin = decode_srgb(self.bgr)
        for k in range(self.fingers):
            part = (k / (self.fingers - 1) - 0.5) if self.fingers > 1 else 0.0
            angle = self.from_rad + part * self.spread_rad + float(rng.normal(0, 0.08))
            root = self.from_rad + 0.35 * part * self.spread_rad
            tip = 1 - self.depth * float(rng.uniform(0.5, 1.3))
            width = self.width * float(rng.uniform(0.8, 1.15)) * radius
            ends = np.array(
                [
                    (x0 + tip * radius * math.cos(angle), y0 + tip * radius * math.sin(angle)),
                    (x0 + REACH_RADII * radius * math.cos(root), y0 + REACH_RADII * radius * math.sin(root)),
                ]
            )
            off = _distance(x, y, ends)
            finger = np.clip((width - off) * patch.finer + 0.5, 0, 1).astype(np.float32)
            shade = (0.45 + 0.55 * np.sqrt(np.clip(1 - (off / width) ** 2, 0, 1))).astype(np.float32)
            tint = skin * np.float32(rng.uniform(0.8, 1.1))
            light += finger[:, :, None] * (shade[:, :, None] * tint - light)
            cover = np.maximum(cover, finger)
        return Layer(cover, light / np.maximum(cover, 1e-6)[:, :, None])


def _circle(outline_px: Points) -> tuple[Points, float]:
    centre = (outline_px.min(axis=0) + outline_px.max(axis=0)) / 2
    return centre, float(np.linalg.norm(outline_px - centre, axis=1).mean())


def _distance(x: Plane, y: Plane, ends: Points) -> Plane:
    """Return how far each sample is from a line between two ends."""
    (xa, ya), (xb, yb) = ends
    length = math.hypot(xb - xa, yb - ya)
    ahead, aside = (xb - xa) / length, (yb - ya) / length
    along = (x[None, :] - xa) * ahead + (y[:, None] - ya) * aside
    along = np.clip(along, 0, length)
    return np.hypot(x[None, :] - xa - along * ahead, y[:, None] - ya - along * aside)
