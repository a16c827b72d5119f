"""Lit tape before the dark, and sheets whose corners are a pixel or two off a rectangle."""

from __future__ import annotations

import math

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from support.scenes import draw
from support.scenes.backdrop import Backdrop, KeepOut, PlainBackdrop
from support.scenes.cut_sheet import CutSheetTarget, GroupTarget, HandCut
from support.scenes.hard_flats import CLUTTER, ROOM, WALL, HardFlat, backdrop_of, placed_whole
from support.scenes.plane import PAPER_BGR, Pose
from support.scenes.room import RoomBackdrop
from support.scenes.scene import Scene
from support.scenes.sensor import Blur, Sensor
from support.scenes.target import Colour, Floats, Target
from support.scenes.tone import decode_srgb

STRIP_M = (0.0508, 0.127)
"""An upright strip of tape, 2 by 5 inches."""

BETWEEN_M = 0.2096
"""From the middle of one strip to that of its twin, 8.25 inches."""

LIT_BGRS: tuple[Colour, ...] = ((250, 255, 252), (120, 250, 140), (170, 255, 185))
"""Retro-reflective tape in the light of a white lamp, and of green ones."""

STRIP_CUT_M = 0.001
"""Their ends are off by up to so much."""

MAX_GLINTS, GLOW, GLOW_PX = 6, 0.06, (2.0, 9.0)
"""What else shines, and how much of the light goes how far astray, at most."""

SKEW_PX = 1.4
"""By how much an end of a strip is off, at most; both sides that meet at a corner move it."""

MOST_SKEW = 0.02
"""No end of a strip is off by more than this share of the side."""

SHARES, EDGES_PX = (0.002, 0.012), (0.3, 1.2)
"""By how much an end of a sheet's side is off at most: a share of the size for the knife, and pixels for its edges."""

SHEET_SIZES_PX, MOST_OFF = (10.0, 250.0), 0.04
"""The shorter side of such a sheet, were it not tilted; no end is off by more than this share of it."""


class SkewCut(HandCut, frozen=True, kw_only=True):
    """A cut along a ruler that was held askew: sides are straight, and each end is off by half of the most or more."""

    def deviation_m(self, side: int, place: Floats) -> Floats:
        """Return by how much a side lies too far out, as `HandCut.deviation_m`."""
        rng = np.random.default_rng((self.seed, 91, side))
        first, last = rng.uniform(0.5, 1.0, 2) * rng.choice((-1, 1), 2) * (self.sides_m if side % 2 else self.ends_m)
        return np.asarray(first + (last - first) * (place + 1) / 2)


class DimBackdrop(Struct, frozen=True, kw_only=True):
    """Another backdrop in a fraction of its light, as a short exposure leaves it.

    Attributes:
        inner: The other one.
        share: How much of its light is left.
    """

    inner: Backdrop
    share: float

    @property
    def avoids_target(self) -> bool:
        """As the other one."""
        return self.inner.avoids_target

    def light(self, width_px: int, height_px: int, seed: int, keep_out: KeepOut | None) -> NDArray[np.float32]:
        """Return its linear light."""
        return self.inner.light(width_px, height_px, seed, keep_out) * np.float32(self.share)


class GlowBackdrop(Struct, frozen=True, kw_only=True):
    """Another backdrop with other things that shine, and the glow that a lens spreads around all that is lit.

    Attributes:
        inner: The other one.
        bgr: The colour of what is lit.
        outlines_px: The outlines of the targets.
        glints: How many other things shine: lamps and what mirrors them, round or askew.
        glow: How much of the light of what is lit goes astray.
        reach_px: How far: the standard deviation.
    """

    inner: Backdrop
    bgr: Colour
    outlines_px: tuple[tuple[tuple[float, float], ...], ...]
    glints: int
    glow: float
    reach_px: float

    @property
    def avoids_target(self) -> bool:
        """It does not."""
        return False

    def light(self, width_px: int, height_px: int, seed: int, keep_out: KeepOut | None) -> NDArray[np.float32]:
        """Return its linear light."""
        rng = np.random.default_rng((seed, 96))
        others = np.zeros((height_px, width_px), np.float32)
        for _ in range(self.glints):
            size, level = float(np.exp(rng.uniform(0.7, 3.3))), float(rng.uniform(0.05, 1.0))
            turns = np.sort(rng.uniform(0, 2 * math.pi, int(rng.choice((3, 5, 12)))))
            rim = np.column_stack((np.cos(turns), float(rng.uniform(0.3, 1)) * np.sin(turns))) * size
            places = np.rint(4 * (rim + rng.uniform((0, 0), (width_px, height_px)))).astype(np.int32)
            cv2.fillPoly(others, [places], level, cv2.LINE_AA, 2)
        lit = others.copy()
        for outline in self.outlines_px:
            cv2.fillPoly(lit, [np.rint(4 * np.array(outline)).astype(np.int32)], 1.0, cv2.LINE_AA, 2)
        spread = others + np.float32(self.glow) * cv2.GaussianBlur(lit, (0, 0), self.reach_px)
        return self.inner.light(width_px, height_px, seed, keep_out) + spread[:, :, None] * decode_srgb(self.bgr)


def lit_tape(seed: int) -> HardFlat:
    """Draw two strips of lit tape side by side, before black or a room in a hundredth of its light."""
    rng = np.random.default_rng((seed, 92))
    bgr = LIT_BGRS[int(rng.integers(len(LIT_BGRS)))]
    sheen, skew = float(rng.uniform(0.0, 0.08)), rng.uniform(0.0, SKEW_PX)
    camera = draw.CAMERA

    def strip(pose: Pose, own_seed: int) -> CutSheetTarget:
        level = replace(pose, roll_rad=pose.roll_rad / 8)
        pixel_m = pose.position_m[2] / camera.fx_px
        most_m = min(float(skew) * pixel_m, MOST_SKEW * max(STRIP_M))
        cut = SkewCut(ends_m=most_m / 3, sides_m=max(most_m, STRIP_CUT_M), seed=own_seed)
        return CutSheetTarget(
            pose=level, width_m=STRIP_M[0], height_m=STRIP_M[1], cut=cut, bgr=bgr, sheen=sheen, seed=own_seed
        )

    def made(pose: Pose) -> GroupTarget:
        first = strip(pose, seed)
        x_m, y_m, z_m = first.pose.placed(np.array([(BETWEEN_M, 0.0)]))[0].tolist()
        return GroupTarget(first=first, others=(strip(replace(pose, position_m=(x_m, y_m, z_m)), seed + 1),))

    target = placed_whole(rng, made, max(STRIP_M), (22.0, 110.0), (0.0, 35.0), camera)
    scene = _taken(rng, seed, target, _before_the_dark(rng, target, bgr))
    return HardFlat(
        scene=scene, backdrop="dark", cut_m=STRIP_CUT_M, width_m=STRIP_M[0], height_m=STRIP_M[1], twins=1, bgr=bgr
    )


def _before_the_dark(rng: np.random.Generator, target: GroupTarget, bgr: Colour) -> Backdrop:
    """Return black, or a room in a hundredth of its light, with glints and the glow of what is lit."""
    behind: Backdrop = PlainBackdrop(bgr=(int(rng.integers(3, 25)),) * 3)
    if rng.random() < 0.5:
        behind = DimBackdrop(inner=RoomBackdrop(things=int(rng.integers(4, 14))), share=float(rng.uniform(0.005, 0.03)))
    outlines = ((each.outline_m() / each.outline_m()[:, 2:])[:, :2] for each in (target.first, *target.others))
    return GlowBackdrop(
        inner=behind,
        bgr=bgr,
        outlines_px=tuple(tuple(map(tuple, draw.CAMERA.project(each).tolist())) for each in outlines),
        glints=int(rng.integers(MAX_GLINTS)),
        glow=float(rng.uniform(0, GLOW)),
        reach_px=float(rng.uniform(*GLOW_PX)),
    )


def rough_sheet(seed: int) -> HardFlat:
    """Draw an A4 sheet that was cut askew, with rough edges, before anything."""
    rng = np.random.default_rng((seed, 97, 0, 0))
    share, edge_px = float(rng.uniform(*SHARES)), float(rng.uniform(*EDGES_PX))
    for _ in range(3):
        rng.integers(3)  # those before the place are of no use any more, and the scenes of seeds stay as they were
    longer_m, shorter_m = max(draw.SHEET_M), min(draw.SHEET_M)
    knife_m = share * math.sqrt(longer_m * shorter_m)

    def made(pose: Pose) -> CutSheetTarget:
        off_m = min(knife_m + edge_px * pose.position_m[2] / draw.CAMERA.fx_px, MOST_OFF * shorter_m)
        return CutSheetTarget(
            pose=replace(pose, roll_rad=pose.roll_rad / 4),
            width_m=draw.SHEET_M[0],
            height_m=draw.SHEET_M[1],
            cut=SkewCut(ends_m=off_m, sides_m=off_m, seed=seed),
            bgr=PAPER_BGR,
            seed=seed,
        )

    least_px, most_px = (longer_m / shorter_m * each for each in SHEET_SIZES_PX)
    sizes_px = (least_px, min(most_px, 0.7 * draw.CAMERA.height_px))
    target = placed_whole(rng, made, longer_m, sizes_px, (0.0, 35.0))
    kind = (WALL, CLUTTER, ROOM)[int(rng.integers(3))]
    scene = _taken(rng, seed, target, backdrop_of(rng, kind, PAPER_BGR))
    return HardFlat(scene=scene, backdrop=kind, cut_m=knife_m, width_m=draw.SHEET_M[0], height_m=draw.SHEET_M[1])


def _taken(rng: np.random.Generator, seed: int, target: Target, behind: Backdrop) -> Scene:
    """Return the scene as a camera takes it."""
    blur = Blur(
        sigma_px=float(rng.uniform(0.5, 1.0)),
        motion_px=float(rng.choice([0.0, 0.0, rng.uniform(0, 1.5)])),
        direction_rad=float(rng.uniform(0, math.pi)),
    )
    sensor = Sensor(
        exposure_ev=float(rng.uniform(-0.6, 0.25)),
        sharpening=float(rng.choice([0.0, 0.3])),
        noise=float(rng.uniform(0.5, 2.0)),
        shot_noise=float(rng.uniform(0.005, 0.03)),
        jpeg_quality=int(rng.integers(70, 93)) if rng.random() < 0.5 else None,
    )
    return Scene(camera=draw.CAMERA, target=target, seed=seed, backdrop=behind, blur=blur, sensor=sensor)
