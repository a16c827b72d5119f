"""Fingers that hold a ball, before it and around it."""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from stadimeter.core.detection import Points
from support.scenes.patch import Patch
from support.scenes.target import Colour, Layer
from support.scenes.tone import decode_srgb

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
