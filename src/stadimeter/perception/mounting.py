"""Judges whether a camera is still where it was and in focus, from views of its background.

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
(not judged)        too dark, too few features, or too large a σ              never a finding
==================  ========================================================  =====================================

A camera on a robot sees another background all the time. Only focus is judged, from the median of many views, and none
counts that shows nearly the same as the one before: a robot that stands before a wall.
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
from stadimeter.perception.background import MIN_FEATURES, MIN_INLIERS, NEAR, BackgroundComparison, BackgroundView
from stadimeter.ranging.view_motion import ViewMotion

# What is certain to be found by features at whole pixels, and no more than a camera needs: 0.12 degrees are a pixel of
# 640 across 60 degrees, and shift a target at 3 m by 6 mm; a zoom by 0.5 % makes distances wrong by as much.
MIN_ROTATION_RAD, MIN_ZOOM = math.radians(0.12), 0.005

# A variance of the blur in px² at 640 px across. A point that became a disc of 2 px has 0.25.
BLUR_PX2 = 0.15

# What is off counts from so many σ on. With a σ of more than this share of its limit, that nothing is off says nothing.
SURE, SIGMA_SHARE = 2.5, 0.5

# The saved view decides alone where its σ is at most this share. What is measured by way of a learnt view has that
# one's errors, and those of the one by which it was learnt: on a rendered day they grew to 0.02 degrees in three hours.
ALONE_SHARE = 0.25

CHECKS_IN_A_ROW = {"moved": 2, "zoomed": 2, "refocused": 2, "unrecognised": 3}

# What a robot sees makes the sharpness of a view differ as much as 0.46 px² of blur do, by the standard deviation of 70
# rendered rooms: the median of an hour's views counts, against that of the first ones. It differs by 0.3 px² from hour
# to hour, as the light does: only a blur of more, such as a disc of 4 px, stands out from that.
ROBOT_CHECKS, ROBOT_BLUR_PX2 = 60, 0.5

# A view is learnt when fewer features than this share of those in sight agree with any that is known, and not again
# for half an hour: at night a third of the features are new in each picture.
LEARN_BELOW, LEARN_APART_CHECKS = 0.35, 30
VIEWS_MAX = 8

# A camera that saw nothing for a day and a night is covered, or looks into a place that no one lights.
DARKENED_CHECKS = 24 * 60


class MountingLimits(Struct, frozen=True, kw_only=True):
    """By how much the mounting may be off: what the calibration states, and no less than can be measured.

    Attributes:
        judges_place: Whether the place is judged: not of a camera on a robot.
    """

    rotation_rad: float = MIN_ROTATION_RAD
    zoom: float = MIN_ZOOM
    judges_place: bool = True


class Judgement(Struct, frozen=True, kw_only=True):
    """The result of one check.

    Attributes:
        found: The findings of this check alone, each in words.
        settled: Those of them that were found often enough to be believed.
        not_judged: Why nothing can be said; else empty.
        best: How the view differs from the saved one, by itself or by way of the one that is most like it.
        has_learnt: Whether a view was learnt, which should be kept.
    """

    found: dict[str, str] = field(default_factory=dict)
    settled: dict[str, str] = field(default_factory=dict)
    not_judged: str = ""
    best: BackgroundComparison | None = None
    has_learnt: bool = False


class MountingJudge(Struct):
    """Judges one view after the other.

    Attributes:
        views: The view that was saved, and those learnt since.
    """

    views: list[BackgroundView]
    limits: MountingLimits = field(default_factory=MountingLimits)
    _in_a_row: dict[str, int] = field(default_factory=dict)
    _dark_checks: int = 0
    _checks_since_learnt: int = LEARN_APART_CHECKS
    _last: BackgroundView | None = None
    _sharpness: deque[float] = field(default_factory=lambda: deque(maxlen=ROBOT_CHECKS))

    def judge(self, view: BackgroundView) -> Judgement:
        """Take in a view; return what it says."""
        if (count := len(view.features)) >= MIN_FEATURES:
            self._dark_checks = 0
            return self._judge_place(view) if self.limits.judges_place else self._judge_on_robot(view)
        self._dark_checks += 1
        words = f"too dark or too plain: {count} features in sight, {MIN_FEATURES} are needed"
        found = {"darkened": f"{words}, for a day and a night"} if self._dark_checks >= DARKENED_CHECKS else {}
        return Judgement(found=found, settled=found, not_judged=words)

    def _judge_place(self, view: BackgroundView) -> Judgement:
        self._checks_since_learnt += 1
        best, agreeing = view.compare(self.views[0]), [len(view.features)]
        if best is None or self._too_uncertain(best.motion, ALONE_SHARE):
            compared = [best, *map(view.compare, self.views[1:])]
            agreeing = [0 if each is None else each.motion.inliers for each in compared]
            best = compared[agreeing.index(max(agreeing))]
        if best is None:
            words = "nothing of the saved view is recognised: turned far, covered, or the room changed"
            return self._settle({"unrecognised": words})
        found = dict(self._off(best))
        not_judged = "" if found else self._too_uncertain(best.motion)
        has_learnt = not found and not not_judged and self._learn(view, agreeing, best)
        return self._settle(found, not_judged=not_judged, best=best, has_learnt=has_learnt)

    def _judge_on_robot(self, view: BackgroundView) -> Judgement:
        same = None if self._last is None else view.compare(self._last)
        if same is not None and same.motion.rotation_rad < NEAR:
            return Judgement(not_judged="the robot stands where it stood at the last check")
        self._last, saved = view, self.views[0]
        self._sharpness.append(float(np.median(view.features["sharpness"])))
        if len(self._sharpness) < ROBOT_CHECKS:
            return self._settle({})
        change = float(np.median(self._sharpness)) - float(np.median(saved.features["sharpness"]))
        blur_px2 = change / saved.blur_slope
        if is_first := len(self.views) == 1:
            self.views.append(replace(saved, blur_px2=blur_px2))
        return self._settle(dict(_refocused(blur_px2 - self.views[1].blur_px2, ROBOT_BLUR_PX2)), has_learnt=is_first)

    def _settle(self, found: dict[str, str], **more: Any) -> Judgement:
        self._in_a_row = {kind: self._in_a_row.get(kind, 0) + 1 for kind in found}
        settled = {kind: found[kind] for kind, times in self._in_a_row.items() if times >= CHECKS_IN_A_ROW[kind]}
        return Judgement(found=found, settled=settled, **more)

    def _off(self, compared: BackgroundComparison) -> Iterator[tuple[str, str]]:
        """Yield what is beyond its limit, in words."""
        limits, motion = self.limits, compared.motion
        if motion.inliers < MIN_INLIERS:
            return
        if motion.rotation_rad > max(limits.rotation_rad, SURE * motion.rotation_sigma_rad):
            turn, most = math.degrees(motion.rotation_rad), math.degrees(limits.rotation_rad)
            yield "moved", f"turned by {turn:.2f}°, limit {most:.2f}°: {motion.in_words()}"
        if abs(motion.zoom) > max(limits.zoom, SURE * motion.sigmas[3]):
            yield "zoomed", f"zoomed by {motion.zoom:+.1%}, limit {limits.zoom:.1%}: distances are off by as much"
        sigma_px2 = compared.blur_sigma_px2
        yield from _refocused(compared.blur_px2, max(BLUR_PX2 + sigma_px2, SURE * sigma_px2))

    def _too_uncertain(self, motion: ViewMotion, share: float = SIGMA_SHARE) -> str:
        """Return why a motion decides nothing; empty if it does."""
        angle, zoom, limits = math.hypot(*motion.sigmas[:2]), motion.sigmas[3], self.limits
        if motion.inliers >= MIN_INLIERS and angle <= share * limits.rotation_rad and zoom <= share * limits.zoom:
            return ""
        return f"{motion.inliers} features agree, too few to be sure to {math.degrees(angle):.2f}° and {zoom:.1%}"

    def _learn(self, view: BackgroundView, agreeing: list[int], best: BackgroundComparison) -> bool:
        """Keep a view that is little like any other, if the mounting is well within its limits; return whether.

        Args:
            agreeing: How many of its features agree with each of the known views.
        """
        motion, features, limits = best.motion, view.features.copy(), self.limits
        if max(agreeing) > LEARN_BELOW * len(features) or self._checks_since_learnt < LEARN_APART_CHECKS:
            return False
        if motion.rotation_rad > limits.rotation_rad / 2 or abs(motion.zoom) > limits.zoom / 2:
            return False
        if len(self.views) >= VIEWS_MAX:
            # The learnt one that is most like it goes: those of another light, such as that of the night, stay.
            del self.views[agreeing.index(max(agreeing[1:]), 1)]
        self._checks_since_learnt = 0
        features["place"] = motion.undo(features["place"])
        self.views.append(replace(view, data=features.tobytes(), blur_px2=best.blur_px2))
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


def _refocused(blur_px2: float, limit_px2: float) -> Iterator[tuple[str, str]]:
    if abs(blur_px2) > limit_px2:
        way = "out of focus" if blur_px2 > 0 else "sharper than when it was saved"
        yield "refocused", f"{way} (a blur of {math.sqrt(abs(blur_px2)):.1f} px at 640 px across)"
