"""Judges whether a camera is still where it was, in focus and clean: from views of its background.

The view that was saved is the measure. By day and by night other things of a room can be seen, so further views are
learnt while the mounting agrees with the first one. Their directions are turned back to it, and their blur is kept
relative to it: a camera that sags a little each day is found, however slowly it goes.

==================  ========================================================  =====================================
finding             when                                                      in how many checks in a row
==================  ========================================================  =====================================
moved, zoomed       a turn or a zoom beyond its limit                         2
refocused           a variance of the blur that differs by more than its      2
                    limit and one standard deviation
unrecognised        features enough, and none of any view are among them      3
dirty               cells that agreed for hours lost their contrast           15
(not judged)        too dark, too few features, or too large a σ              never a finding
==================  ========================================================  =====================================

A camera on a robot sees another background all the time. Only focus and dirt are judged, from what the views of a while
have in common, and none counts that shows nearly the same as the one before: a robot that stands before a wall.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import Any

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.perception.background import (
    AGREEING_PER_CELL,
    CELLS,
    MIN_FEATURES,
    NEAR,
    BackgroundComparison,
    BackgroundLook,
    BackgroundView,
)
from stadimeter.ranging.view_motion import ViewMotion

# What is certain to be found by features at whole pixels, and no more than a camera needs: 0.12 degrees are a pixel of
# 640 across 60 degrees, and shift a target at 3 m by 6 mm; a zoom by 0.5 % makes distances wrong by as much.
MIN_ROTATION_RAD, MIN_ZOOM = math.radians(0.12), 0.005

# A variance of the blur in px² at 640 px across. A point that became a disc of 2 px has 0.25.
BLUR_PX2 = 0.15

# A result whose σ is more than this share of its limit decides nothing.
SIGMA_SHARE = 0.5

CHECKS_IN_A_ROW = {"moved": 2, "zoomed": 2, "refocused": 2, "unrecognised": 3, "dirty": 15}

# Dirt covers two cells of 48 at least. Each must have agreed in this share of the checks of the last hours, and so
# through changes of the light: the rim of a patch of sunlight has features too, and moves on with the sun. People who
# stand about for a quarter of an hour are rarely that plain.
DIRTY_CELLS, STEADY_SHARE, STEADY_CHECKS = 2, 0.8, 60

# On a robot, what is seen makes the sharpness differ as much as a blur of half a pixel does: the median of an hour's
# views counts, and only a blur of a pixel, such as a disc of 4 px.
ROBOT_CHECKS, ROBOT_BLUR_PX2 = 60, 1.0

# A view is learnt when fewer features than this share of those in sight agree with any that is known.
LEARN_BELOW = 0.35
VIEWS_MAX = 8

# Below this mean grey level the picture is noise.
DARK = 12.0


class MountingLimits(Struct, frozen=True, kw_only=True):
    """By how much the mounting may be off: what the calibration states, and no less than can be measured.

    Attributes:
        judges_place: Whether the place is judged: not of a camera on a robot.
    """

    rotation_rad: float = MIN_ROTATION_RAD
    zoom: float = MIN_ZOOM
    blur_px2: float = BLUR_PX2
    judges_place: bool = True


class Judgement(Struct, frozen=True, kw_only=True):
    """What one check says.

    Attributes:
        kinds: The findings of this check alone.
        settled: Those of them that were found often enough to be believed.
        words: What is wrong, of those; else empty.
        not_judged: Why nothing can be said; else empty.
        best: How the view differs from the one that is most like it.
        has_learnt: Whether a view was learnt, which should be kept.
    """

    kinds: frozenset[str] = frozenset()
    settled: frozenset[str] = frozenset()
    words: str = ""
    not_judged: str = ""
    best: BackgroundComparison | None = None
    has_learnt: bool = False


class MountingJudge(Struct):
    """Judges one view after the other.

    Attributes:
        views: The view that was saved, and those learnt since.
        steadiness: Of each cell of the picture, in which share of the last checks it agreed.
    """

    views: list[BackgroundView]
    limits: MountingLimits = field(default_factory=MountingLimits)
    steadiness: list[float] = field(default_factory=lambda: [0.0] * CELLS)
    _in_a_row: dict[str, int] = field(default_factory=dict)
    _seen_at: list[int] = field(default_factory=list)
    _checks: int = 0
    _last: BackgroundView | None = None
    _sharpness: deque[float] = field(default_factory=lambda: deque(maxlen=ROBOT_CHECKS))

    def judge(self, look: BackgroundLook) -> Judgement:
        """Take in a view; return what it says."""
        self._checks += 1
        self._seen_at += [0] * (len(self.views) - len(self._seen_at))
        if look.view.brightness < DARK or look.view.count < MIN_FEATURES:
            few = f"{look.view.count} features in sight, {MIN_FEATURES} are needed"
            return Judgement(not_judged="the picture is too dark" if look.view.brightness < DARK else few)
        return self._judge_place(look) if self.limits.judges_place else self._judge_on_robot(look)

    def _judge_place(self, look: BackgroundLook) -> Judgement:
        compared = [look.compare(each) for each in self.views]
        at = max(range(len(compared)), key=lambda each: compared[each].matched)
        best = compared[at]
        self._seen_at[at] = self._checks
        blur_px2 = best.blur_px2 + self.views[at].blur_px2
        found = {} if best.motion is None else dict(self._off(best.motion, blur_px2, best.blur_sigma_px2))
        if best.motion is None:
            found["unrecognised"] = "nothing of the saved view is recognised: turned far, covered, or the room changed"
        agreeing = {cell for each in compared for cell in each.agreeing_cells}
        lost = {cell for each in compared for cell in each.lost_cells}
        found |= self._dirt(agreeing, lost, compared[0].agreeing_cells)
        not_judged = "" if found or best.motion is None else _too_uncertain(best.motion, self.limits)
        has_learnt = not found and not not_judged and self._learn(look.view, best, blur_px2)
        return self._settle(found, not_judged, best=best, has_learnt=has_learnt)

    def _judge_on_robot(self, look: BackgroundLook) -> Judgement:
        same = None if self._last is None else look.compare(self._last).motion
        if same is not None and same.rotation_rad < NEAR:
            return Judgement(not_judged="the robot stands where it stood at the last check")
        self._last = look.view
        self._sharpness.append(float(np.median(look.view.features["sharpness"])))
        found: dict[str, str] = {}
        if len(self._sharpness) == self._sharpness.maxlen:
            saved = self.views[0]
            change = float(np.median(self._sharpness)) - float(np.median(saved.features["sharpness"]))
            found = dict(self._refocused(change / saved.blur_slope, ROBOT_BLUR_PX2))
        agreeing = set(look.cells_with(look.view.features["place"], AGREEING_PER_CELL))
        return self._settle(found | self._dirt(agreeing, {*range(CELLS)}, agreeing), "")

    def _settle(self, found: dict[str, str], not_judged: str, **more: Any) -> Judgement:
        self._in_a_row = {kind: self._in_a_row.get(kind, 0) + 1 for kind in found}
        settled = frozenset(kind for kind in found if self._in_a_row[kind] >= CHECKS_IN_A_ROW[kind])
        words = "; ".join(found[kind] for kind in found if kind in settled)
        return Judgement(kinds=frozenset(found), settled=settled, words=words, not_judged=not_judged, **more)

    def _off(self, motion: ViewMotion, blur_px2: float, blur_sigma_px2: float) -> Iterator[tuple[str, str]]:
        """Yield what is beyond its limit, in words."""
        limits = self.limits
        if not _too_uncertain(motion, limits) and motion.rotation_rad > limits.rotation_rad:
            turn, most = math.degrees(motion.rotation_rad), math.degrees(limits.rotation_rad)
            yield "moved", f"turned by {turn:.2f}°, limit {most:.2f}°: {motion.in_words()}"
        if not _too_uncertain(motion, limits) and abs(motion.zoom) > limits.zoom:
            yield "zoomed", f"zoomed by {motion.zoom:+.1%}, limit {limits.zoom:.1%}: distances are off by as much"
        yield from self._refocused(blur_px2, limits.blur_px2 + blur_sigma_px2)

    def _refocused(self, blur_px2: float, limit_px2: float) -> Iterator[tuple[str, str]]:
        if abs(blur_px2) > limit_px2:
            way = "out of focus" if blur_px2 > 0 else "sharper than when it was saved"
            yield "refocused", f"{way} (a blur of {math.sqrt(abs(blur_px2)):.1f} px at 640 px across)"

    def _dirt(self, agreeing: set[int], lost: set[int], steady: frozenset[int] | set[int]) -> dict[str, str]:
        """Return what is to be said of cells that always agreed, and have lost their contrast and agree no more.

        Args:
            steady: Those that agree with the saved view: later ones know the light of their hour, and its rims.
        """
        dirty = sum(self.steadiness[cell] >= STEADY_SHARE for cell in lost - agreeing)
        if not dirty:  # else what dirt covers would soon count as plain
            changes = ((cell in steady) - share for cell, share in enumerate(self.steadiness))
            self.steadiness = [s + c / STEADY_CHECKS for s, c in zip(self.steadiness, changes, strict=True)]
        words = f"dirt or something before the lens: {dirty} of {CELLS} parts of the picture lost contrast"
        return {"dirty": words} if dirty >= DIRTY_CELLS else {}

    def _learn(self, view: BackgroundView, best: BackgroundComparison, blur_px2: float) -> bool:
        """Keep a view that is little like any other, if the mounting is well within its limits; return whether."""
        motion = best.motion
        if motion is None or best.matched > LEARN_BELOW * view.count:
            return False
        if motion.rotation_rad > self.limits.rotation_rad / 2 or abs(motion.zoom) > self.limits.zoom / 2:
            return False
        if len(self.views) >= VIEWS_MAX:  # in place of the one that was longest of no use; never of the saved one
            oldest = min(range(1, len(self.views)), key=self._seen_at.__getitem__)
            del self.views[oldest], self._seen_at[oldest]
        features = view.features.copy()
        features["place"] = motion.undo(features["place"])
        self.views.append(replace(view, data=features.tobytes(), blur_px2=blur_px2))
        self._seen_at.append(self._checks)
        return True


def limits_for(lens: CameraModel, tilt_sigma_rad: float | None, *, is_on_robot: bool) -> MountingLimits:
    """Return the limits for what a configuration states.

    Args:
        tilt_sigma_rad: How well the camera's tilt is known, if the configuration says so.
    """
    return MountingLimits(
        rotation_rad=max(MIN_ROTATION_RAD, tilt_sigma_rad or 0.0),
        zoom=max(MIN_ZOOM, lens.focal_relative_sigma),
        judges_place=not is_on_robot,
    )


def _too_uncertain(motion: ViewMotion, limits: MountingLimits) -> str:
    """Return why a motion decides nothing; empty if it does."""
    angle, zoom = float(np.hypot(*motion.sigmas[:2])), motion.sigmas[3]
    if angle <= SIGMA_SHARE * limits.rotation_rad and zoom <= SIGMA_SHARE * limits.zoom:
        return ""
    return f"{motion.inliers} features agree, too few to be sure to {math.degrees(angle):.2f}° and {zoom:.1%}"
