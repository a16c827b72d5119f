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
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.core.words import about
from stadimeter.errors import CalibrationError

# Turn and zoom of a camera between two views of things that stand still.
#
# A camera that turns about its lens moves each direction d = (x, y) to the projection of R (x, y, 1), whatever the
# distance of what is seen there; one whose focal length grows by a factor multiplies directions by it. The three
# angles and the logarithm of the factor are fitted by Gauss and Newton's method with Tukey's weights (P. Huber and E.
# Ronchetti, "Robust Statistics", 2009), from a start that RANSAC finds.
#
# A shift of the principal point looks like a turn of the camera to within the second order of the angle, so the two
# are not distinguished: either makes bearings wrong by as much. A camera that was moved sideways shifts near things
# further than far ones: no turn explains that, and fewer features agree.

Directions = NDArray[np.float64]

ROUNDS = 12

# Tukey's constant in standard deviations: 95 % of the efficiency of least squares where errors are normal.
TUKEY = 4.685

# RANSAC takes a match as right within this many pixels. A turn of the camera bends the picture by less over a view.
RANSAC_PX = 4.0

# Features are found at whole pixels, so their places are no better than this, though all may agree.
ROUNDED_PX = 0.3

# Errors of neighbouring features are alike, such as those from a shadow. On rendered days without any movement the
# scatter of the result is this many times what independent errors would give.
CORRELATION_FACTOR = 2.0


class ViewMotion(Struct, frozen=True, kw_only=True):
    """The motion of the camera between two views.

    Attributes:
        pan_rad: How far it turned to the right, or its principal point moved to the left.
        tilt_rad: How far it turned up.
        roll_rad: How far its right side went down.
        zoom: By which share its focal length grew; 0.01 makes everything appear 1 % larger.
        sigmas: The standard deviations of these four.
        inliers: How many features agree.
    """

    pan_rad: float
    tilt_rad: float
    roll_rad: float
    zoom: float
    sigmas: tuple[float, float, float, float]
    inliers: int

    def undo(self, directions: Directions) -> Directions:
        """Return where directions of now were in the earlier view."""
        back = _rotation_matrix(self.tilt_rad, self.pan_rad, self.roll_rad)
        return _moved(directions / (1 + self.zoom), back)

    def in_words(self) -> str:
        """Describe what moved by how much, with standard deviations."""
        angles = zip(("pan", "tilt", "roll"), (self.pan_rad, self.tilt_rad, self.roll_rad), self.sigmas, strict=False)
        turned = (f"{name} {math.degrees(by):+.2f}° ± {about(math.degrees(sigma))}°" for name, by, sigma in angles)
        zoom = f"zoom {self.zoom:+.2%} ± {about(100 * self.sigmas[3])}%"
        return f"{', '.join(turned)}, {zoom} ({self.inliers} features agree)"

    @property
    def rotation_rad(self) -> float:
        """The angle of the whole turn."""
        return math.hypot(self.pan_rad, self.tilt_rad, self.roll_rad)

    @property
    def rotation_sigma_rad(self) -> float:
        """Its standard deviation; that of the roll is some three times the others."""
        turns = (self.pan_rad, self.tilt_rad, self.roll_rad)
        return math.hypot(*(by * sigma for by, sigma in zip(turns, self.sigmas, strict=False))) / max(
            self.rotation_rad, 1e-9
        )


def fit_view_motion(
    before: Directions, now: Directions, focal_px: float, min_inliers: int
) -> tuple[ViewMotion, NDArray[np.bool_]] | None:
    """Find how the camera moved and which matches agree; None if fewer than `min_inliers` do.

    Args:
        before: Directions of matched features in the earlier view, shape (n, 2).
        now: Those of the same features now.
    """
    if len(before) < min_inliers:
        return None
    start, chosen = cv2.estimateAffinePartial2D(before * focal_px, now * focal_px, ransacReprojThreshold=RANSAC_PX)
    if start is None or int(chosen.sum()) < min_inliers:
        return None
    # The start: a similarity is a roll, a zoom, and a shift by the pan and the tilt.
    zoom = math.log(math.hypot(start[0, 0], start[1, 0]))
    roll = math.atan2(start[1, 0], start[0, 0])
    rotation = _rotation_matrix(-start[1, 2] / focal_px, start[0, 2] / focal_px, roll)
    weights = np.asarray(chosen, np.float64).ravel()
    scale = RANSAC_PX / focal_px / 2
    for _ in range(ROUNDS):
        predicted = _moved(before, np.diag((math.exp(zoom), math.exp(zoom), 1.0)) @ rotation)
        slopes, residuals = _slopes(predicted), now - predicted
        scale = max(1.4826 * float(np.median(np.abs(residuals[weights > 0]))), ROUNDED_PX / focal_px)
        off = np.hypot(*residuals.T) / (TUKEY * scale)
        weights = np.where(off < 1, (1 - off**2) ** 2, 0.0)
        inliers = int((weights > 0).sum())
        if inliers < min_inliers:
            return None
        normal = np.einsum("nak,nal,n->kl", slopes, slopes, weights)
        step = np.linalg.solve(normal, np.einsum("nak,na,n->k", slopes, residuals, weights))
        rotation, zoom = _rotation_matrix(*step[:3]) @ rotation, zoom + step[3]
    of_tilt, of_pan, of_roll, of_zoom = (CORRELATION_FACTOR * scale * np.sqrt(np.diag(np.linalg.inv(normal)))).tolist()
    # Things move against the camera.
    tilt, pan, roll = (-float(each) for each in cv2.Rodrigues(rotation)[0].ravel())
    sigmas, zoom = (of_pan, of_tilt, of_roll, of_zoom), math.expm1(zoom)
    motion = ViewMotion(pan_rad=pan, tilt_rad=tilt, roll_rad=roll, zoom=zoom, sigmas=sigmas, inliers=inliers)
    return motion, weights > 0


def _rotation_matrix(x_rad: float, y_rad: float, z_rad: float) -> NDArray[np.float64]:
    return np.asarray(cv2.Rodrigues(np.array([x_rad, y_rad, z_rad]))[0], np.float64)


def _moved(directions: Directions, by: NDArray[np.float64]) -> Directions:
    return np.asarray(cv2.perspectiveTransform(directions[None], by)[0], np.float64)


def _slopes(at: Directions) -> NDArray[np.float64]:
    """Return the change of directions with three angles and the logarithm of the zoom, shape (n, 2, 4)."""
    x, y = at.T
    along = (-x * y, 1 + x**2, -y, x), (-(1 + y**2), x * y, x, y)
    return np.stack([np.stack(each, axis=-1) for each in along], axis=1)


# Things that stand still in a camera's view, and what they show of the camera: turned, zoomed or out of focus ---------
#
# A view is a few hundred ORB features (E. Rublee and others, "ORB: an efficient alternative to SIFT or SURF",
# 2011), spread over the picture: directions, descriptors, and how sharp each one's surroundings are. No picture can
# be made of them.
#
# Sharpness is the energy of the finest details divided by that of details of some 2 to 6 pixels. Light, shade and
# exposure change both alike; a lens out of focus takes the finest first. The energies come from products of two
# pictures of one moment, so that noise, which is new in each, has no part in their mean, by night as by day (see
# `picture_flow`). How much a blur takes depends on what is seen: it is tried out on the picture itself when a view
# is taken, which turns the ratio into pixels of blur.

Plane = NDArray[np.float32]

# Pictures are looked at with this width at most. All pixels here are of that size.
WIDTH_MAX_PX = 640

# The picture is divided so, and the cells give their features in turn, the strongest first: else a bookcase would give
# all.
CELLS_ACROSS, CELLS_DOWN, FEATURES_MAX = 8, 6, 480

# The lowest difference of grey levels of a corner. A picture by night has few stronger ones.
FAST_LEVELS = 8

# A view with fewer features in fewer cells cannot be compared: a white wall has none, a wall with one picture too few.
MIN_FEATURES, MIN_CELLS = 60, 8

# With fewer agreeing matches nothing is concluded. Wrong matches agree by chance on a turn with 8 at most, but where a
# bookcase makes many alike: those that agree are never this share of all.
MIN_INLIERS, AGREEING_SHARE = 15, 0.35

# A camera that hardly moved is looked for first: features within this of where they were, some 3 degrees. So few are
# left to be confused that faint ones count too, and fewer that agree show that it looks the same way.
NEAR, MIN_INLIERS_NEAR = 0.05, 8

# Two descriptors of 256 bits of one feature differ by less, in another light too where it is looked for nearby. Those
# of two features differ by 128 on average.
HAMMING_MAX, HAMMING_MAX_NEAR = 64, 80

# What is this near to a target is not background: its shadow, and its blur.
RIM_PX = 10

# What is seen beside a feature counts within this half width.
SURROUNDINGS_PX = 6

# Where two pictures of one moment correlate less, most is noise. In the dark some 7 of 480 features are left.
ALIKE_MIN = 0.5

# A feature stands still that moves by less than this from one moment to the next.
STILL_PX = 1.5

# Blur is tried out with this variance, in px².
TRIED_BLUR_PX2 = 0.25

MEDIAN_SIGMA_PER_MAD = 1.858

# Of each feature: its direction in the axes of the camera as it was when it was saved, 256 bits, the logarithm of the
# sharpness around it, and the cell of the picture.
FEATURE = np.dtype([("place", "<f8", 2), ("bits", "u1", 32), ("sharpness", "<f4"), ("cell", "u1")])


class BackgroundComparison(Struct, frozen=True, kw_only=True):
    """The state of the camera as a view shows it, compared with an earlier one.

    Attributes:
        motion: How it moved.
        blur_px2: By how much the variance of the blur grew, since the view that was saved.
        blur_sigma_px2: Its standard deviation.
    """

    motion: ViewMotion
    blur_px2: float
    blur_sigma_px2: float

    def in_words(self) -> str:
        """Describe what differs, with standard deviations."""
        return f"{self.motion.in_words()}, blur {self.blur_px2:+.2f} ± {self.blur_sigma_px2:.2f} px²"


class BackgroundView(Struct, frozen=True, kw_only=True):
    """The features of a view, ready for a file.

    Attributes:
        data: The features, each as `FEATURE`.
        focal_px: The focal length at the resolution that is looked at.
        blur_slope: How the median sharpness changes with the variance of the blur, per px²; below zero.
        blur_px2: By how much its blur's variance differs from that of the view that was saved.
    """

    data: bytes
    focal_px: float
    blur_slope: float
    blur_px2: float = 0.0

    @property
    def features(self) -> NDArray[Any]:
        """The features, as an array of `FEATURE`."""
        return np.frombuffer(self.data, FEATURE)

    def compare(self, earlier: BackgroundView) -> BackgroundComparison | None:
        """Find what differs from an earlier view; None if too few features agree."""
        then, now = earlier.features, self.features
        for within, fewest in ((NEAR, MIN_INLIERS_NEAR), (math.inf, MIN_INLIERS)):
            theirs, ours = match_features(then, now, within)
            least = max(fewest, round(AGREEING_SHARE * len(theirs)))
            found = fit_view_motion(then["place"][theirs], now["place"][ours], self.focal_px, least)
            if found is not None:
                break
        else:
            return None
        motion, agrees = found
        sharpness = now["sharpness"][ours[agrees]] - then["sharpness"][theirs[agrees]]
        middle = float(np.median(sharpness))
        sigma = MEDIAN_SIGMA_PER_MAD * float(np.median(np.abs(sharpness - middle))) / motion.inliers**0.5
        blur_px2, blur_sigma_px2 = middle / earlier.blur_slope, sigma / abs(earlier.blur_slope)
        return BackgroundComparison(motion=motion, blur_px2=earlier.blur_px2 + blur_px2, blur_sigma_px2=blur_sigma_px2)


def look_at(pictures: Sequence[Image], lens: CameraModel, hidden: Sequence[NDArray[np.float64]] = ()) -> BackgroundView:
    """Return the view that some pictures of one moment show.

    Args:
        pictures: An even number. Every other one is averaged, and so are the others: two with noise of their own.
        lens: The camera model at their resolution.
        hidden: Outlines in their pixels of what does not belong to the background, such as targets.
    """
    scale = min(1.0, WIDTH_MAX_PX / lens.width_px)
    small = lens.scaled_to(round(lens.width_px * scale), round(lens.height_px * scale))
    size, scale = (small.width_px, small.height_px), small.width_px / lens.width_px
    greys = [
        cv2.resize(cv2.cvtColor(each, cv2.COLOR_BGR2GRAY), size, interpolation=cv2.INTER_AREA) for each in pictures
    ]
    planes = [np.asarray(np.mean(greys[half::2], axis=0), np.float32) for half in (0, 1)]
    sharpness, alike = _sharpness(*planes)
    mask = np.where(alike > ALIKE_MIN, 255, 0).astype(np.uint8)
    for outline in hidden:  # with a rim around it
        x, y, width, height = cv2.boundingRect((outline * scale).astype(np.float32))
        cv2.rectangle(mask, (x - RIM_PX, y - RIM_PX), (x + width + RIM_PX, y + height + RIM_PX), 0, -1)
    found, bits = _find_features(np.mean(planes, axis=0).astype(np.uint8), mask)
    features, slope = np.zeros(len(found), FEATURE), -1.0
    if found:
        points = np.array([each.pt for each in found])
        features["cell"], features["bits"] = [each.class_id for each in found], bits
        blurred = [np.asarray(cv2.GaussianBlur(each, (0, 0), TRIED_BLUR_PX2**0.5), np.float32) for each in planes]
        column, row = points.round().astype(np.intp).T
        features["place"] = small.directions(points)
        features["sharpness"] = sharpness[row, column]
        change = float(np.median(_sharpness(*blurred)[0][row, column] - features["sharpness"]))
        slope = min(change / TRIED_BLUR_PX2, -0.1)
    return BackgroundView(data=features.tobytes(), focal_px=small.fx_px, blur_slope=slope)


def keep_still(views: Sequence[BackgroundView]) -> BackgroundView:
    """Keep what is in all of some views of a camera that stood still.

    Raises:
        CalibrationError: It is too little to be compared with later views; the message says what to do.
    """
    first, *others = views
    features = first.features
    for now in (each.features for each in others):
        theirs, ours = match_features(features, now, NEAR)
        shift_px = np.hypot(*(now["place"][ours] - features["place"][theirs]).T) * first.focal_px
        features = features[theirs[shift_px < STILL_PX]]
    cells = len(np.unique(features["cell"]))
    if len(features) < MIN_FEATURES or cells < MIN_CELLS:
        raise CalibrationError(
            f"the view has {len(features)} features that stand still, in {cells} of {CELLS_ACROSS * CELLS_DOWN} parts "
            f"of the picture; {MIN_FEATURES} in {MIN_CELLS} are needed. A plain wall or a dark room shows no movement "
            "of the camera: give it light, and something with edges to see, such as a poster"
        )
    return replace(first, data=features.tobytes())


def match_features(then: NDArray[Any], now: NDArray[Any], within: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return which features are the same, by their positions: each the nearest of the other.

    Args:
        within: How far apart their directions may be.
    """
    if not len(then) or not len(now):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    # Bits that differ are those of either less twice those of both.
    theirs, ours = (np.unpackbits(each["bits"], axis=1).astype(np.float32) for each in (then, now))
    differing = theirs.sum(axis=1)[:, None] + ours.sum(axis=1) - 2 * theirs @ ours.T
    for axis in (0, 1) if within < math.inf else ():
        apart = then["place"][:, axis, None].astype(np.float32) - now["place"][:, axis].astype(np.float32)
        differing[np.abs(apart) > within] = 256
    most = HAMMING_MAX_NEAR if within < math.inf else HAMMING_MAX
    nearest, back, one = differing.argmin(axis=1), differing.argmin(axis=0), np.arange(len(then))
    is_mutual = (back[nearest] == one) & (differing[one, nearest] < most)
    return one[is_mutual], nearest[is_mutual]


def _find_features(grey: NDArray[np.uint8], mask: NDArray[np.uint8]) -> tuple[Sequence[cv2.KeyPoint], Any]:
    """Return the strongest features of each cell, whose number is their class, and their descriptors."""
    orb = cv2.ORB.create(nfeatures=4000, scaleFactor=1.2, nlevels=2, fastThreshold=FAST_LEVELS)
    height_px, width_px = grey.shape
    ranked: list[tuple[int, cv2.KeyPoint]] = []
    stronger: Counter[int] = Counter()
    for each in sorted(orb.detect(grey, mask), key=lambda each: -each.response):
        column, row = int(each.pt[0] * CELLS_ACROSS // width_px), int(each.pt[1] * CELLS_DOWN // height_px)
        each.class_id = column + CELLS_ACROSS * row  # which travels with it
        ranked.append((stronger[each.class_id], each))
        stronger[each.class_id] += 1
    return orb.compute(grey, [each for _, each in sorted(ranked, key=lambda each: each[0])[:FEATURES_MAX]])


def _sharpness(one: Plane, other: Plane) -> tuple[Plane, Plane]:
    """Return at each pixel the logarithm of the sharpness, and how far two pictures of one moment correlate."""
    near, far = ([cv2.GaussianBlur(each, (0, 0), sigma) for each in (one, other)] for sigma in (1.0, 3.0))
    fine, coarse = ([a - b for a, b in zip(*each, strict=True)] for each in (((one, other), near), (near, far)))
    pairs = (fine, coarse, coarse[:1] * 2, coarse[1:] * 2)
    # A grey level of 0.1 is below all that noise leaves: no logarithm of nothing.
    size = (2 * SURROUNDINGS_PX + 1,) * 2
    of_fine, of_coarse, *alone = (np.maximum(cv2.boxFilter(a * b, -1, size), 0.01) for a, b in pairs)
    return np.log(of_fine / of_coarse), of_coarse / np.sqrt(alone[0] * alone[1])


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

# A view is learnt when fewer features than this share of those in sight agree with any that is known, and not again
# for half an hour: at night a third of the features are new in each picture.
LEARN_BELOW, LEARN_APART_CHECKS = 0.35, 30
VIEWS_MAX = 8

# A camera that saw nothing for a day and a night is covered, or looks into a place that no one lights.
DARKENED_CHECKS = 24 * 60


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
        rotation_rad: By how much the camera may be turned: what its calibration states, or the least that is measured.
        zoom: The same of the zoom, as a share.
    """

    views: list[BackgroundView]
    rotation_rad: float = MIN_ROTATION_RAD
    zoom: float = MIN_ZOOM
    _in_a_row: dict[str, int] = field(default_factory=dict)
    _dark_checks: int = 0
    _checks_since_learnt: int = LEARN_APART_CHECKS

    def judge(self, view: BackgroundView) -> Judgement:
        """Take in a view; return what it says."""
        if (count := len(view.features)) >= MIN_FEATURES:
            self._dark_checks = 0
            return self._judge_place(view)
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

    def _settle(self, found: dict[str, str], **more: Any) -> Judgement:
        self._in_a_row = {kind: self._in_a_row.get(kind, 0) + 1 for kind in found}
        settled = {kind: found[kind] for kind, times in self._in_a_row.items() if times >= CHECKS_IN_A_ROW[kind]}
        return Judgement(found=found, settled=settled, **more)

    def _off(self, compared: BackgroundComparison) -> Iterator[tuple[str, str]]:
        """Yield what is beyond its limit, in words."""
        motion = compared.motion
        if motion.inliers < MIN_INLIERS:
            return
        if motion.rotation_rad > max(self.rotation_rad, SURE * motion.rotation_sigma_rad):
            turn, most = math.degrees(motion.rotation_rad), math.degrees(self.rotation_rad)
            yield "moved", f"turned by {turn:.2f}°, limit {most:.2f}°: {motion.in_words()}"
        if abs(motion.zoom) > max(self.zoom, SURE * motion.sigmas[3]):
            yield "zoomed", f"zoomed by {motion.zoom:+.1%}, limit {self.zoom:.1%}: distances are off by as much"
        sigma_px2 = compared.blur_sigma_px2
        if abs(compared.blur_px2) > max(BLUR_PX2 + sigma_px2, SURE * sigma_px2):
            way = "out of focus" if compared.blur_px2 > 0 else "sharper than when it was saved"
            yield "refocused", f"{way} (a blur of {math.sqrt(abs(compared.blur_px2)):.1f} px at 640 px across)"

    def _too_uncertain(self, motion: ViewMotion, share: float = SIGMA_SHARE) -> str:
        """Return why a motion decides nothing; empty if it does."""
        angle, zoom = math.hypot(*motion.sigmas[:2]), motion.sigmas[3]
        if motion.inliers >= MIN_INLIERS and angle <= share * self.rotation_rad and zoom <= share * self.zoom:
            return ""
        return f"{motion.inliers} features agree, too few to be sure to {math.degrees(angle):.2f}° and {zoom:.1%}"

    def _learn(self, view: BackgroundView, agreeing: list[int], best: BackgroundComparison) -> bool:
        """Keep a view that is little like any other, if the mounting is well within its limits; return whether.

        Args:
            agreeing: How many of its features agree with each of the known views.
        """
        motion, features = best.motion, view.features.copy()
        if max(agreeing) > LEARN_BELOW * len(features) or self._checks_since_learnt < LEARN_APART_CHECKS:
            return False
        if motion.rotation_rad > self.rotation_rad / 2 or abs(motion.zoom) > self.zoom / 2:
            return False
        if len(self.views) >= VIEWS_MAX:
            # The learnt one that is most like it goes: those of another light, such as that of the night, stay.
            del self.views[agreeing.index(max(agreeing[1:]), 1)]
        self._checks_since_learnt = 0
        features["place"] = motion.undo(features["place"])
        self.views.append(replace(view, data=features.tobytes(), blur_px2=best.blur_px2))
        return True
