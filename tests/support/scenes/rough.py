"""Flat things whose corners are a pixel or two off a rectangle: cut askew, with rough edges, small and large."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from msgspec.structs import replace

from stadimeter.core.detection import Points
from support.scenes import draw
from support.scenes.cut_sheet import CutSheetTarget, GroupTarget
from support.scenes.hard_flats import PAPER_BGR, HardFlat, backdrop_of, placed_whole
from support.scenes.plane import Pose
from support.scenes.taped import (
    BETWEEN_M,
    BOARD_BGRS,
    BOARD_M,
    LIT_BGRS,
    SMALL_CAMERA,
    SQUARE_BGR,
    SQUARE_M,
    STRIP_M,
    SkewCut,
    before_the_dark,
    beside,
    taken,
)
from support.scenes.target import Target

Rough = Literal["sheet", "square", "strip"]

SHARES, EDGES_PX = (0.002, 0.012), (0.3, 1.2)
"""By how much an end of a side is off at most: a share of the size for the knife, and pixels for rough edges."""

MOST_OFF = 0.04
"""No end is off by more than this share of the shorter side."""

SIZES_PX, SMALL_SIZES_PX = (10.0, 250.0), (8.0, 100.0)
"""The shorter side, were it not tilted, at 640 × 480 and at 320 × 240."""

MOST_TILT_DEG = {"sheet": 35.0, "square": 20.0, "strip": 35.0}


class PartlySeen(GroupTarget, frozen=True, kw_only=True):
    """A target with other things beside or below it, which the border may cut."""

    def extent_m(self) -> Points:
        """Return the true sides of the target."""
        return self.first.extent_m()


def rough_flat(seed: int, what: Rough, *, small: bool = False) -> HardFlat:
    """Draw an A4 sheet before anything, green squares on a board, or a pair of lit strips of tape before the dark.

    Args:
        seed: The scene.
        what: Which of them.
        small: Whether the picture has 320 × 240 pixels, soft, stored as a JPEG.
    """
    rng = np.random.default_rng((seed, 97, ("sheet", "square", "strip").index(what), small))
    camera, sizes_px = (SMALL_CAMERA, SMALL_SIZES_PX) if small else (draw.CAMERA, SIZES_PX)
    side_m = {"sheet": draw.SHEET_M, "square": (SQUARE_M, SQUARE_M), "strip": STRIP_M}[what]
    aspect = max(side_m) / min(side_m)
    share, edge_px = float(rng.uniform(*SHARES)), float(rng.uniform(*EDGES_PX))
    bgr = {"sheet": PAPER_BGR, "square": SQUARE_BGR, "strip": LIT_BGRS[int(rng.integers(len(LIT_BGRS)))]}[what]
    board_bgr = BOARD_BGRS[int(rng.integers(len(BOARD_BGRS)))]
    apart_m = {"sheet": (), "square": (0.13, -0.13)[: int(rng.integers(3))], "strip": (BETWEEN_M,)}[what]

    def cut(pose: Pose, sides_m: tuple[float, float], colour: tuple[int, int, int], number: int) -> CutSheetTarget:
        own_px = edge_px * pose.position_m[2] / camera.fx_px
        longer, shorter = max(sides_m), min(sides_m)
        # Tape has the width that it was made with; of it only the ends are cut.
        of_knife = share * math.sqrt(longer * shorter)
        sides_off = min(of_knife + own_px, MOST_OFF * shorter)
        ends_off = min(own_px, MOST_OFF * shorter) if what == "strip" else sides_off
        skew = SkewCut(ends_m=ends_off, sides_m=sides_off, seed=seed + 10 * number)
        return CutSheetTarget(
            pose=pose, width_m=sides_m[0], height_m=sides_m[1], cut=skew, bgr=colour, seed=seed + 10 * number
        )

    def made(pose: Pose) -> Target:
        level = replace(pose, roll_rad=pose.roll_rad / 4)
        first = cut(level, side_m, bgr, 0)
        others = [cut(beside(level, (x_m, 0.0), (0.0, 0.0)), side_m, bgr, n) for n, x_m in enumerate(apart_m, 1)]
        if what == "square":
            others.append(cut(level, BOARD_M, board_bgr, 3))
        group = PartlySeen if what == "square" else GroupTarget
        return group(first=first, others=tuple(others)) if others else first

    longest_px = tuple(aspect * each for each in sizes_px)
    target = placed_whole(
        rng,
        made,
        max(side_m),
        (longest_px[0], min(longest_px[1], 0.7 * camera.height_px)),
        (0.0, MOST_TILT_DEG[what]),
        camera,
    )
    if isinstance(target, PartlySeen):  # all of it is drawn
        target = GroupTarget(first=target.first, others=target.others)
    kind = ("wall", "clutter", "room")[int(rng.integers(3 if what == "sheet" else 2))]
    behind = backdrop_of(
        rng, "room" if what == "square" and kind == "clutter" else kind, board_bgr if what == "square" else bgr
    )
    if what == "strip":
        behind = before_the_dark(rng, target, bgr, camera)
    scene = taken(rng, seed, camera, target, behind, small=small)
    return HardFlat(
        scene=scene,
        backdrop=kind,
        cut_m=share * math.sqrt(side_m[0] * side_m[1]),
        width_m=side_m[0],
        height_m=side_m[1],
        bgr=bgr,
    )
