"""The pose of a plane by least squares: from a first one to that whose corners appear nearest to where they were seen.

Levenberg's and Marquardt's method with derivatives in closed form (R. Hartley and A. Zisserman, "Multiple View
Geometry", appendix 6). For four corners plain numbers are faster than arrays, and two steps are enough from a pose in
closed form.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Vector = tuple[float, float, float]
Seen = Sequence[Sequence[float]]
Values = NDArray[np.float64]

# A step that would take less than this share off the sum of squares is the last one.
MAX_STEPS = 8
SETTLED_SHARE = 1e-3

# The first damping, a share of the normal matrix's diagonal, and what it grows by where a step makes things worse.
DAMPING, GROWTH = 1e-6, 30.0


class PlanePose(NamedTuple):
    """A pose of a plane: its axes in the camera frame, towards its right and its top, and where its centre is."""

    right: Vector
    up: Vector
    position_m: Vector


def linearise(pose: PlanePose, corners_m: Seen, seen: Seen) -> tuple[Values, Values] | None:
    """Return how seen corners change with a small turn about the camera's axes and a shift, and how far off they are.

    The shapes are ``(2 n, 6)`` and ``(2 n,)``, per unit of depth. None where a corner is not in front of the camera.
    """
    (ax, ay, az), (bx, by, bz), (px, py, pz) = pose
    rows: list[tuple[float, ...]] = []
    off: list[float] = []
    for (a, b, *_), (seen_x, seen_y) in zip(corners_m, seen, strict=True):
        x, y, z = a * ax + b * bx, a * ay + b * by, a * az + b * bz
        depth = z + pz
        if not depth > 0:
            return None
        nearness = 1 / depth
        u, v = (x + px) * nearness, (y + py) * nearness
        # Derivatives of u = X / Z and v = Y / Z: a turn w moves the corner by w × (x, y, z), a shift by itself.
        # Columns: turn about x, y, z, then shift along x, y, z.
        rows.append((-u * y * nearness, (z + u * x) * nearness, -y * nearness, nearness, 0.0, -u * nearness))
        rows.append((-(z + v * y) * nearness, v * x * nearness, x * nearness, 0.0, nearness, -v * nearness))
        off += (seen_x - u, seen_y - v)
    return np.array(rows), np.array(off)


def refine(pose: PlanePose, corners_m: Seen, seen: Seen) -> PlanePose:
    """Return the pose nearby whose corners, x and y in its plane, appear nearest to where they were seen."""
    now = linearise(pose, corners_m, seen)
    damping = DAMPING
    for _ in range(MAX_STEPS):
        if now is None:
            return pose
        jacobian, off = now
        square = float(off @ off)
        normal = jacobian.T @ jacobian
        # Every seventh element of a flat 6 by 6 matrix is its diagonal.
        normal.flat[::7] *= 1 + damping
        slope = jacobian.T @ off
        try:
            step = np.linalg.solve(normal, slope)
        except np.linalg.LinAlgError:
            return pose
        # What the step would take off the sum of squares if all were linear; below 0.1 % of it nothing is gained.
        gain = float(step @ slope)
        if not gain > SETTLED_SHARE * square:
            return pose
        moved = _move(pose, step.tolist())
        then = linearise(moved, corners_m, seen)
        if then is not None and float(then[1] @ then[1]) < square:
            pose, now, damping = moved, then, damping / GROWTH
        else:
            damping *= GROWTH
    return pose


def _move(pose: PlanePose, step: Sequence[float]) -> PlanePose:
    """Return a pose turned about the camera's axes and shifted."""
    turn, shift = (step[0], step[1], step[2]), step[3:]
    right, up = _turn(pose.right, turn), _turn(pose.up, turn)
    x, y, z = pose.position_m
    return PlanePose(right, up, (x + shift[0], y + shift[1], z + shift[2]))


def _turn(vector: Vector, turn: Vector) -> Vector:
    """Return a vector turned about an axis by its length in radians (Rodrigues)."""
    angle = math.hypot(*turn)
    sine, rest = (math.sin(angle) / angle, (1 - math.cos(angle)) / angle**2) if angle > 1e-9 else (1.0, 0.5)
    (x, y, z), (a, b, c) = vector, turn
    across = (b * z - c * y, c * x - a * z, a * y - b * x)
    p, q, r = across
    again = (b * r - c * q, c * p - a * r, a * q - b * p)
    turned = [old + sine * one + rest * two for old, one, two in zip(vector, across, again, strict=True)]
    return turned[0], turned[1], turned[2]
