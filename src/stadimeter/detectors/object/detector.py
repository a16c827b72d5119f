"""Finding an object: the network looks from time to time, and its box is followed in between.

**State.** A detector keeps no state, but this one remembers what the network saw last (`LastLook`, and nothing else): a
network takes 20 to 500 ms a picture, and what it saw, a pattern of corners, does not fit into a prediction. The rule is
kept as far as a recording needs it: answers follow from the frames and their capture times alone, and what is
remembered is used only for later frames of the same size. The same frame again, an earlier one, or one of another size
is looked at as if there had been none before.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import (
    Detection,
    DetectionStatus,
    Flags,
    Plane,
    Points,
    Prediction,
    Profiles,
    RejectedCandidate,
    Values,
)
from stadimeter.core.frame import Frame, Image, SensorBoxes
from stadimeter.detectors.object.families import Boxes, one_each, overlaps
from stadimeter.detectors.object.network import Network
from stadimeter.detectors.protocol import check_image
from stadimeter.detectors.sampling import Region, grey_of
from stadimeter.ranging.flat import UprightShape

# Following a box from picture to picture without a network: how it moved and grew since the network saw it.
#
# Corners inside of the box are found once, in the picture that the network saw, and looked for in each later one by the
# pyramidal Lucas-Kanade method (J.-Y. Bouguet, "Pyramidal implementation of the Lucas Kanade feature tracker", Intel,
# 2001). Always against that first picture, so nothing drifts. What does not lead back to where it began is left out
# (Z. Kalal et al., "Forward-backward error", ICPR 2010), and the medians over the rest tell how the box moved and grew.

# The box's longer side in the reduced picture in which it is followed. A growth of 1 % moves corners at its ends by a
# third of a pixel then, and they are found to a tenth. At 96 px it took twice as long and was no better.
FOLLOWED_PX = 64

# The part of the box, from its middle on, in which corners are taken: beyond it is mostly background.
INNER_SHARE = 0.8

# How far around the box the later picture is looked at, in shares of its longer side.
REACH_SHARE = 0.3

# The side of the square in which it is looked for then.
VIEW_PX = math.ceil(FOLLOWED_PX * (1 + 2 * REACH_SHARE)) + 2

MAX_CORNERS = 24
MIN_CORNERS = 8

# Corners that do not lead back, or do not move as the box does, by more than this many reduced pixels.
MAX_ASTRAY_PX = 1.5

# Fewer of the corners than this share that move alike are no box.
MIN_SHARE = 0.4

# The box may grow or shrink by this factor since the network saw it: at 3 m, 1 m nearer.
MAX_GROWTH = 1.5

_WINDOW, _LEVELS = (11, 11), 2
_STEPS = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 10, 0.03)


class BoxPlace(NamedTuple):
    """Place of a box: its centre, and its size as a factor of that which the network saw."""

    centre_px: tuple[float, float]
    growth: float = 1.0


class ReducedView(NamedTuple):
    """A part of a picture, reduced, in the upper left of a square; the rest repeats its last pixels."""

    grey: Plane
    left_top_px: Points
    scale: Points

    def reduce(self, points_px: Points) -> Points:
        """Return where points of the picture are in it."""
        return np.asarray((points_px - self.left_top_px) * self.scale)

    def enlarge(self, points: Points) -> Points:
        """Return where points in it are in the picture."""
        return np.asarray(points / self.scale + self.left_top_px)


class BoxPattern(Struct, frozen=True, kw_only=True, eq=False):
    """The look of a box when the network saw it.

    Attributes:
        long_px: Its longer side.
        view: The picture around it.
        corners: Corners in that, shape ``(n, 2)``.
        around_px: The same in pixels of the picture, from the centre of the box.
    """

    long_px: float
    view: ReducedView
    corners: Points
    around_px: Points


class FollowedBox(NamedTuple):
    """Place of a box now, and the standard deviation of its growth, as a share."""

    place: BoxPlace
    growth_sigma: float


def take_pattern(image: Image, corners_px: Values) -> BoxPattern | str:
    """Return the pattern of a box to follow, given by left, top, right and bottom; or why nothing can be followed."""
    centre, half = (corners_px[:2] + corners_px[2:]) / 2, (corners_px[2:] - corners_px[:2]) / 2
    long_px = float(2 * half.max())
    view = _view(image, BoxPlace((float(centre[0]), float(centre[1]))), long_px)
    if view is None:
        return "it is outside of the picture"
    ends = np.stack((centre - INNER_SHARE * half, centre + INNER_SHARE * half))
    (left, top), (right, bottom) = view.reduce(ends).round().astype(int).clip(0)
    mask = np.zeros_like(view.grey)
    mask[top:bottom, left:right] = 255
    found = cv2.goodFeaturesToTrack(view.grey, MAX_CORNERS, 0.01, 4, mask=mask)
    corners = np.empty((0, 2)) if found is None else np.asarray(found, np.float64).reshape(-1, 2)
    if len(corners) < MIN_CORNERS:
        return f"it has {len(corners)} corners to be followed by, limit {MIN_CORNERS}"
    return BoxPattern(long_px=long_px, view=view, corners=corners, around_px=view.enlarge(corners) - centre)


def follow_box(image: Image, pattern: BoxPattern, near: BoxPlace) -> FollowedBox | str:
    """Return where the box is now, looked for around a place; or why it is not there."""
    view = _view(image, near, pattern.long_px)
    if view is None:
        return "it would be outside of the picture"
    first = pattern.corners.astype(np.float32)
    start = view.reduce(near.growth * pattern.around_px + near.centre_px).astype(np.float32)
    seen, is_seen = _flow(pattern.view.grey, view.grey, first, start)
    back, is_back = _flow(view.grey, pattern.view.grey, seen, first)
    good = is_seen & is_back & (np.abs(back - first).max(axis=1) < MAX_ASTRAY_PX)
    enough = max(MIN_CORNERS, MIN_SHARE * len(good))
    if good.sum() < enough:
        return f"{good.sum()} of {len(good)} corners in it are found again, limit {enough:.0f}"
    before, now = pattern.around_px[good], view.enlarge(seen[good].astype(np.float64))
    growth, sigma, is_alike = _growth(before, now, MAX_ASTRAY_PX / float(view.scale.min()))
    if is_alike.sum() < enough:
        return f"{is_alike.sum()} of {len(good)} corners in it move alike, limit {enough:.0f}"
    if not 1 / MAX_GROWTH < growth < MAX_GROWTH:
        return f"it is {growth:.2f} times as large as the network saw it, limit {MAX_GROWTH:g}"
    x_px, y_px = np.median((now - growth * before)[is_alike], axis=0).tolist()
    return FollowedBox(BoxPlace((x_px, y_px), growth), sigma)


def _view(image: Image, near: BoxPlace, long_px: float) -> ReducedView | None:
    """Return the picture around a box, reduced so that this has the size in which it is followed."""
    size_px = long_px * near.growth
    region = Region.around(near.centre_px, (0.5 + REACH_SHARE) * size_px, image)
    if region is None:
        return None
    part, scale = region.of(image), min(1.0, FOLLOWED_PX / size_px)
    # Halved as often as possible, which is the mean of four pixels and quick, and the rest of the way linearly.
    halvings = min(max(0, math.floor(-math.log2(scale))), min(part.shape[:2]).bit_length() - 1)
    part = part[: part.shape[0] >> halvings << halvings, : part.shape[1] >> halvings << halvings]
    columns, rows = (min(VIEW_PX, max(1, round(side * scale))) for side in (part.shape[1], part.shape[0]))
    small = part
    for _ in range(halvings):
        half = small.shape[1] // 2, small.shape[0] // 2
        small = np.asarray(cv2.resize(small, half, interpolation=cv2.INTER_AREA), np.uint8)
    grey = cv2.resize(grey_of(small), (columns, rows), interpolation=cv2.INTER_LINEAR)
    # The method takes two pictures of one size only.
    grey = cv2.copyMakeBorder(grey, 0, VIEW_PX - rows, 0, VIEW_PX - columns, cv2.BORDER_REPLICATE)
    exact = np.array((columns / part.shape[1], rows / part.shape[0]))
    return ReducedView(np.asarray(grey, np.uint8), region.left_top_px, exact)


def _flow(one: Plane, other: Plane, points: Profiles, start: Profiles) -> tuple[Profiles, Flags]:
    """Return where points of one picture are in another one, looked for around a start, and which were found."""
    found, is_found, _ = cv2.calcOpticalFlowPyrLK(
        one, other, points, start.copy(), winSize=_WINDOW, maxLevel=_LEVELS, criteria=_STEPS,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )  # fmt: skip
    return np.asarray(found, np.float32), is_found.ravel() > 0


def _growth(before: Points, now: Points, astray_px: float) -> tuple[float, float, Flags]:
    """Return by which factor points moved apart, its standard deviation, and which points moved alike.

    The factor is the median over the pairs of points that are farther apart than most.
    """
    one, other = np.triu_indices(len(before), 1)
    apart = np.hypot(*(before[one] - before[other]).T)
    far = apart >= np.median(apart)
    growth = float(np.median(np.hypot(*(now[one] - now[other]).T)[far] / apart[far]))
    off = now - growth * before
    off_px = np.hypot(*(off - np.median(off, axis=0)).T)
    is_alike = off_px < astray_px
    alike = before[is_alike]
    if not len(alike):
        return growth, math.inf, is_alike
    # Least squares: each coordinate errs by σ, the growth by σ / √(sum of the squared distances from the middle).
    spread = float(((alike - alike.mean(axis=0)) ** 2).sum())
    return growth, math.sqrt(float((off_px[is_alike] ** 2).mean()) / 2 / max(spread, 1e-9)), is_alike


# A followed box errs by this share more with each second since the network saw it. On 60 drawn figures that came
# nearer, moved, leant and were lit otherwise, its growth was off by 0.3 % (median) and 1.5 % (p95) after half a second;
# living things change more.
SIGMA_PER_S = 0.03

# A side of a box nearer to the border of the picture than this, in pixels and as a share of the box, may be cut off:
# networks draw boxes of cut people some percent inside of the border.
BORDER_PX, BORDER_SHARE = 2.0, 0.02

# Boxes that score at least this share of the limit are listed as rejected.
NEARLY = 0.5

MAX_REJECTED = 12

# A box with a shorter side than this is a chance of few pixels: a person of 12 px is 4 px wide.
MIN_SIDE_PX = 4.0

# One thing is surely nearer than another if it is larger by this many standard deviations of both: 11 % for people.
NEARER_SIGMAS = 2.0

# Where no prediction says which of several is meant, it is the one where the last box was, for this long after it.
MEANT_FOR_S = 1.5


class LoadedNetwork(Struct, frozen=True, kw_only=True, eq=False):
    """A network with the class that is looked for: its number, and what it is called."""

    network: Network
    number: int
    what: str


class ObjectSearch(Struct, frozen=True, kw_only=True, eq=False):
    """Settings of the search for an object.

    Attributes:
        every_s: The network looks once in this time of capture.
        min_score: Boxes of lower scores are not accepted.
        load: Loads the network; a `DriverError` says why it cannot be. None for one on the camera's sensor.
        class_name: What is looked for in what that one has found.
    """

    shape: UprightShape
    every_s: float
    min_score: float
    load: Callable[[], LoadedNetwork] | None
    class_name: str = ""


class Thing(Struct, frozen=True, kw_only=True, eq=False):
    """One box of the network, in pixels of the picture, moved and scaled to where it is in a later one."""

    boxes: Boxes  # one
    place: BoxPlace

    @property
    def corners(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom."""
        left, top, right, bottom = self.boxes.corners[0]
        (x, y), half_x, half_y = self.place.centre_px, (right - left) / 2, (bottom - top) / 2
        half_x, half_y = half_x * self.place.growth, half_y * self.place.growth
        return x - half_x, y - half_y, x + half_x, y + half_y

    @property
    def eyes(self) -> tuple[tuple[float, float], tuple[float, float]] | None:
        """Both eyes of a face."""
        if self.boxes.eyes is None:
            return None
        was = (self.boxes.corners[0, :2] + self.boxes.corners[0, 2:]) / 2
        one, other = ((self.boxes.eyes[0] - was) * self.place.growth + self.place.centre_px).tolist()
        return tuple(one), tuple(other)

    @classmethod
    def first(cls, boxes: Boxes) -> Thing:
        """Return a box where the network sees it."""
        x, y = ((boxes.corners[0, :2] + boxes.corners[0, 2:]) / 2).tolist()
        return cls(boxes=boxes, place=BoxPlace((x, y)))


class LastLook(Struct, frozen=True, kw_only=True, eq=False):
    """Findings of the network's last look.

    Attributes:
        at_s: When that picture was captured.
        size_px: Width and height of the picture.
        answer: What was answered then.
        thing: The box, where it was followed to; None if there was none, or it was cut off.
        pattern: What it is followed by; the reason if it cannot be.
        is_lost: Whether it could not be followed, so that the network looks at the next picture.
    """

    at_s: float
    size_px: tuple[int, int]
    answer: Detection
    thing: Thing | None = None
    pattern: BoxPattern | str = ""
    is_lost: bool = False

    def age_s(self, frame: Frame) -> float:
        """Return the time since then; infinity for a frame that does not follow on it."""
        age_s = frame.captured_at_s - self.at_s
        return age_s if age_s > 0 and self.size_px == (frame.width_px, frame.height_px) else math.inf


class ObjectDetector:
    """Finds one thing of a class by a network."""

    def __init__(self, name: str, search: ObjectSearch) -> None:
        self._name = name
        self._search = search
        self._shape = search.shape
        self._loaded: LoadedNetwork | None = None
        self._memory: LastLook | None = None

    @property
    def _what(self) -> str:
        return self._loaded.what if self._loaded else self._search.class_name

    @property
    def target_shape(self) -> UprightShape:
        """The length that is known of it."""
        return self._shape

    def detect(
        self,
        frame: Frame,
        prediction: Prediction | None = None,
        *,
        lens: CameraModel | None = None,  # noqa: ARG002
    ) -> Detection:
        """Look for the thing: of several the one nearest to the prediction, unless another is nearer, or the largest.

        Raises:
            DriverError: The network cannot be loaded or run.
        """
        check_image(frame)
        memory = self._memory
        if memory is None or memory.is_lost or memory.age_s(frame) >= self._search.every_s:
            if self._search.load is None and frame.boxes is None:
                return self._missing("the camera has no result of a network with this picture: set network in [camera]")
            return self._look(frame, prediction)
        if memory.thing is None:
            since = f"when the network last looked, {memory.age_s(frame):.2f} s before"
            return replace(memory.answer, reason=f"{memory.answer.reason}, {since}")
        return self._follow(frame, prediction, memory, memory.thing)

    def _look(self, frame: Frame, prediction: Prediction | None) -> Detection:
        limit = self._search.min_score
        boxes = self._boxes(frame, NEARLY * limit)
        short_px = (boxes.corners[:, 2:] - boxes.corners[:, :2]).min(axis=1)
        is_likely = (boxes.scores >= limit) & (short_px >= MIN_SIDE_PX)
        likely, unlikely = (boxes.take(np.flatnonzero(which)) for which in (is_likely, ~is_likely))
        pattern: BoxPattern | str = ""
        if len(likely.scores):
            chosen, remark = self._choose(likely, prediction, frame)
            others = likely.take(np.delete(np.arange(len(likely.scores)), chosen))
            thing = Thing.first(likely.take(np.array([chosen])))
            answer = self._report(thing, frame, 0.0, remark, self._rejected(others, unlikely))
            pattern = take_pattern(frame.image, thing.boxes.corners[0])
        else:
            thing = None
            refused = self._rejected(likely, unlikely)
            best = f": the likeliest box {refused[0].reason}" if refused else ""
            answer = self._missing(f"no {self._what}{best}", refused)
        is_whole = answer.status is DetectionStatus.FOUND
        size_px = frame.width_px, frame.height_px
        self._memory = LastLook(
            at_s=frame.captured_at_s, size_px=size_px, answer=answer, thing=thing if is_whole else None, pattern=pattern
        )
        return answer

    def _boxes(self, frame: Frame, min_score: float) -> Boxes:
        if self._search.load is not None:
            loaded = self._loaded = self._loaded or self._search.load()
            return loaded.network.find(frame.image, loaded.number, min_score)
        found = frame.boxes or SensorBoxes(np.empty((0, 4)), np.empty(0), ())
        is_meant = np.array(found.classes, object) == self._search.class_name
        which = np.flatnonzero(is_meant & (found.scores >= min_score))
        return one_each(Boxes(found.corners_px, found.scores).take(which))

    def _follow(self, frame: Frame, prediction: Prediction | None, memory: LastLook, thing: Thing) -> Detection:
        pattern = memory.pattern
        followed: FollowedBox | str = pattern if isinstance(pattern, str) else ""
        for near in _starts(thing, prediction):
            if isinstance(pattern, BoxPattern) and not isinstance(followed, FollowedBox):
                followed = follow_box(frame.image, pattern, near)
        if not isinstance(followed, FollowedBox):
            self._memory = replace(memory, is_lost=True)
            return self._missing(f"the {self._what} is not followed until the network looks again: {followed}")
        thing = replace(thing, place=followed.place)
        self._memory = replace(memory, thing=thing)
        share = math.hypot(SIGMA_PER_S * memory.age_s(frame), followed.growth_sigma)
        return self._report(thing, frame, share, "", memory.answer.rejected)

    def _choose(self, likely: Boxes, prediction: Prediction | None, frame: Frame) -> tuple[int, str]:
        """Return which of some boxes is meant, and a remark if there was a choice.

        One track stands for all, so the one that is followed gives way to one that is surely nearer: an alarm on a
        person must not be late since another one, farther away, was seen first.
        """
        count = len(likely.scores)
        if count == 1:
            return 0, ""
        sides = likely.corners[:, 2:] - likely.corners[:, :2]
        whole = np.array(
            [not self._cut_side(Thing.first(likely.take(np.array([each]))), frame) for each in range(count)]
        )
        known = sides[:, 0 if self._shape.known == "width" else 1]
        expected, remark = self._expected(likely.corners, prediction, frame)
        if expected is None:
            areas = sides.prod(axis=1)
            return int(np.where(whole, areas, areas * 1e-9).argmax()), f"the largest of {count} in view"
        nearest = int(np.where(whole, known, 0.0).argmax())
        surely = 1 + NEARER_SIGMAS * math.sqrt(2) * self._shape.box_sigma
        if whole[nearest] and known[nearest] > surely * known[expected]:
            return nearest, f"the nearest of {count}"
        return expected, f"the one of {count} that {remark}"

    def _expected(self, corners: Values, prediction: Prediction | None, frame: Frame) -> tuple[int | None, str]:
        """Return the box of the one that is followed, and why it is that; None where none is."""
        if prediction is not None and all(map(math.isfinite, prediction.centre_px)):
            off = np.abs((corners[:, :2] + corners[:, 2:]) / 2 - prediction.centre_px).max(axis=1)
            return int(off.argmin()), "is nearest to where it was expected"
        memory = self._memory
        last = memory.thing if memory and memory.age_s(frame) <= self._search.every_s + MEANT_FOR_S else None
        if last is not None and (common := overlaps(np.array(last.corners), corners)).max() > 0:
            return int(common.argmax()), "the network saw last"
        return None, ""

    def _report(
        self, thing: Thing, frame: Frame, followed_share: float, remark: str, rejected: tuple[RejectedCandidate, ...]
    ) -> Detection:
        left, top, right, bottom = thing.corners
        width_px, height_px = right - left, bottom - top
        centre = thing.place.centre_px
        known_px = height_px if self._shape.known == "height" else width_px
        if self._shape.known == "eye_distance" and thing.eyes is not None:
            (x, y), (other_x, other_y) = thing.eyes
            known_px = width_px = height_px = max(math.hypot(other_x - x, other_y - y), 1e-6)
            centre = (x + other_x) / 2, (y + other_y) / 2
        side = self._cut_side(thing, frame)
        cut = f"the {self._what}, {right - left:.0f}x{bottom - top:.0f} px, is cut off by the {side} border"
        return Detection(
            target=self._name,
            status=DetectionStatus.TRUNCATED if side else DetectionStatus.FOUND,
            reason=cut if side else remark,
            outline_px=np.array(((left, top), (right, top), (right, bottom), (left, bottom))),
            centre_px=centre,
            width_px=width_px,
            height_px=height_px,
            size_sigma_px=known_px * math.hypot(self._shape.box_sigma, followed_share),
            quality=float(min(max(thing.boxes.scores[0], 0.0), 1.0)),
            rejected=rejected,
        )

    def _cut_side(self, thing: Thing, frame: Frame) -> str:
        """Return the border that may cut off the known length of a thing; an empty string if none does."""
        left, top, right, bottom = thing.corners
        margin_px = max(BORDER_PX, BORDER_SHARE * max(right - left, bottom - top))
        if self._shape.known == "eye_distance" and thing.eyes is not None:
            (left, top), (right, bottom) = np.min(thing.eyes, axis=0), np.max(thing.eyes, axis=0)
        across = {"left": left < margin_px, "right": right > frame.width_px - 1 - margin_px}
        down = {"top": top < margin_px, "bottom": bottom > frame.height_px - 1 - margin_px}
        sides = {"height": down, "width": across, "eye_distance": {**across, **down}}[self._shape.known]
        return " and ".join(name for name, is_cut in sides.items() if is_cut)

    def _rejected(self, others: Boxes, unlikely: Boxes) -> tuple[RejectedCandidate, ...]:
        found = []
        for boxes in (others, unlikely):
            for (left, top, right, bottom), score in zip(boxes.corners.tolist(), boxes.scores.tolist(), strict=True):
                why = f"scores {score:.2f}, limit {self._search.min_score:g}"
                if boxes is others:
                    why = f"is another {self._what}, score {score:.2f}"
                elif score >= self._search.min_score:
                    why = f"has a side of {min(right - left, bottom - top):.1f} px, limit {MIN_SIDE_PX:g} px"
                corners = (left, top), (right, top), (right, bottom), (left, bottom)
                centre, size_px = ((left + right) / 2, (top + bottom) / 2), max(right - left, bottom - top)
                found.append(RejectedCandidate(centre_px=centre, size_px=size_px, reason=why, corners_px=corners))
        return tuple(found[:MAX_REJECTED])

    def _missing(self, reason: str, rejected: tuple[RejectedCandidate, ...] = ()) -> Detection:
        return Detection(target=self._name, status=DetectionStatus.NOT_FOUND, reason=reason, rejected=rejected)


def _starts(thing: Thing, prediction: Prediction | None) -> list[BoxPlace]:
    """Return where to look for a box: where it is expected, if that may be, and where it was last."""
    last = thing.place
    left, _, right, _ = thing.corners
    if prediction is None or not math.dist(prediction.centre_px, last.centre_px) < right - left:
        return [last]
    return [BoxPlace(prediction.centre_px, last.growth), last]
