"""A range of colours for a ball that a person points at, or that stands out in the picture by itself.

Ranges of many widths are drawn up around a place (`stadimeter.detectors.hsv`), and the detector itself judges them: the
range with which it sees the best ball there wins. Without a place, the blobs that stand out by a colour of their own
are tried (`_pick_vivid`). Several places, and several pictures in several lights, join into one range.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import NamedTuple, Protocol

import cv2
import numpy as np
from msgspec.structs import replace

from stadimeter.core.detection import Detection, DetectionStatus, RejectedCandidate
from stadimeter.core.frame import Frame, Image
from stadimeter.detectors.hsv import HsvRange, Mask, Place, join_ranges, ranges_at, smooth, vivid_ranges_at, widen
from stadimeter.detectors.protocol import ColourProposal, ColourSample, ColourView

# A place that gives a better ball than this by its own colour is on no stripe.
SURE_SCORE = 0.6

# Greatest distance of a ball's centre from the place that was pointed at, as a share of the diameter.
AT_PLACE = 0.55

# A wider range is better if the ball is as good with it. Grey is a ball's colour less often than a gloss on it.
WIDER_BONUS, GREY_SHARE = 0.03, 0.7

# Cost of covering an area elsewhere as large as the ball; areas beyond the second figure, in balls, cost no more.
ELSEWHERE_COSTS, MAX_ELSEWHERE = 0.1, 10.0

# A ball of this diameter is no less likely than a larger one.
LARGE_PX = 40.0

# At each of those, some ranges of a middling width tell whether it is a ball: the number of narrower ones, of up to
# 18 in all, and how many are tried.
MAX_VIVID_BLOBS = 8
MIDDLING_FROM, FIRST_TRIED = 5, 3

# The highest possible score of a ball with one of those ranges: a place that cannot beat the best is not tried.
PERFECT_SCORE = 1 + WIDER_BONUS * (FIRST_TRIED - 1)

# Where several places are given, every second range is tried at each: they join into one that is wide enough.
STEP_OF_SEVERAL = 2

# Number of ranges at a place, the best, that are tried in the whole picture, where clutter may be a better ball.
MAX_VERIFIED = 5

# Pictures with a longer side than this are searched smaller.
SEARCH_PX = 800

# Other things of the colour count from this area on, and from this share of the ball's.
THING_PX2, THING_SHARE, MAX_THINGS = 25.0, 0.05, 8

MARGIN_SHARE, MAX_HUE_MARGIN = 0.25, 20

# Blobs are looked for in ranges of hues that overlap: this far apart, and reaching so far to either side.
SEARCH_WIDTH_PX = 320.0
HUES_APART, HUE_REACH = 8, 9

# In each range, among pixels whose channels differ by as many levels: vivid things touch paler ones of their hue.
CHROMA_LEVELS = (20, 40, 70, 110)

# Width of the ring around a blob that its colour is compared with.
MAX_BLOBS_PER_HUE = 6
AREA_PX2, MAX_PICTURE_SHARE = 30, 0.3
RING_PX = 4

# A difference of the colours of a blob and its surroundings that begins to show, in levels of a* and b*.
APART_LEVELS = 5.0

# Blobs of a greater radius are no better for that.
LARGE_BLOB_RADIUS_PX = 30.0

OVERLAP = 0.7


class _Range(NamedTuple):
    """A range of colours, and how good a ball is seen with it."""

    score: float
    colour: HsvRange


class Detect(Protocol):
    """Looks for a ball of any size with a range of colours: everywhere, or quickly at one place."""

    def __call__(self, frame: Frame, colour: HsvRange, around_px: Place | None = None) -> Detection:
        """Return the detection."""


def propose(samples: Sequence[ColourSample], detect: Detect) -> ColourProposal | None:
    """Return the range of colours of a ball; None if nothing there looks like one, or the background was pointed at.

    In a picture without a place, the ball is looked for with the range of those before it first.
    """
    found: list[HsvRange] = []
    for frame, places in map(_shrink, samples):
        known = places or _find_place(found, frame, detect)
        if known:
            step = 1 if len(known) == 1 else STEP_OF_SEVERAL
            found += filter(None, (_find_range(frame, place, detect, step) for place in known))
        else:
            found += _find_standing_out(frame, detect)
    if not found:
        return None
    # A place on a white stripe, a gloss or a shadow has no hue: a ball that has a hue elsewhere is not grey.
    colour = join_ranges([each for each in found if not _is_grey(each)] or found)
    views = tuple(view(frame, colour, detect) for frame, _ in samples)
    return ColourProposal(colour=str(colour), views=views, hue_margin=_find_hue_margin(samples, views, colour))


def _shrink(sample: ColourSample) -> ColourSample:
    """Return a picture that is small enough to be searched many times."""
    (height, width), places = sample.frame.image.shape[:2], sample.places_px
    scale = SEARCH_PX / max(height, width)
    if scale >= 1:
        return sample
    image = cv2.resize(sample.frame.image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    smaller = tuple(((x_px + 0.5) * scale - 0.5, (y_px + 0.5) * scale - 0.5) for x_px, y_px in places)
    return ColourSample(replace(sample.frame, image=np.asarray(image, np.uint8)), smaller)


def _find_place(found: Sequence[HsvRange], frame: Frame, detect: Detect) -> tuple[Place, ...]:
    """Return where the ball is by the ranges of other pictures; nothing if it is not seen with them."""
    detection = detect(frame, join_ranges(found)) if found else None
    return (detection.centre_px,) if detection and detection.status is DetectionStatus.FOUND else ()


def _find_range(frame: Frame, place: Place, detect: Detect, step: int = 1) -> HsvRange | None:
    """Return the best range at a place; where no ball is seen with any, one of a middling width; None of background."""
    hsv = smooth(frame.image)
    by_place = list(ranges_at(hsv, place))
    best = _pick_range(frame, by_place[::step], place, detect)
    if best is None or best.score < SURE_SCORE:
        near = _pick_range(frame, islice(vivid_ranges_at(hsv, place), None, None, step), place, detect)
        best = near if best is None or (near is not None and near.score > best.score) else best
    if best is not None:
        return best.colour
    return by_place[len(by_place) // 2] if by_place else None


def _find_standing_out(frame: Frame, detect: Detect) -> list[HsvRange]:
    """Return the best range of what stands out in a picture most, as a list; an empty one if that is no ball."""
    hsv = smooth(frame.image)
    best_so_far, place = 0.0, None
    for blob in _pick_vivid(frame.image, MAX_VIVID_BLOBS):  # the best first
        if best_so_far >= PERFECT_SCORE * blob.score:
            break
        ranges = list(islice(ranges_at(hsv, blob.place), MIDDLING_FROM + FIRST_TRIED))[-FIRST_TRIED:]
        score = max((each.score for each in _try_ranges(frame, ranges, blob.place, detect)), default=0.0)
        if score * blob.score > best_so_far:
            best_so_far, place = score * blob.score, blob.place
    best_there = None if place is None else _find_range(frame, place, detect)
    return [] if best_there is None else [best_there]


def _pick_range(frame: Frame, ranges: Iterable[HsvRange], place: Place, detect: Detect) -> _Range | None:
    """Return the range with which the best ball is seen at a place, and none elsewhere that is taken for it."""
    tried = sorted(_try_ranges(frame, ranges, place, detect), key=lambda each: each.score, reverse=True)
    return next((each for each in tried[:MAX_VERIFIED] if _is_at(place, detect(frame, each.colour))), None)


def _is_at(place: Place, detection: Detection) -> bool:
    is_found = detection.status is not DetectionStatus.NOT_FOUND
    return is_found and math.dist(detection.centre_px, place) <= AT_PLACE * detection.width_px


def _try_ranges(frame: Frame, ranges: Iterable[HsvRange], place: Place, detect: Detect) -> Iterator[_Range]:
    """Yield the ranges with which a ball is seen at a place."""
    for number, colour in enumerate(ranges):
        detection = detect(frame, colour, place)
        if not _is_at(place, detection):
            continue
        size = math.sqrt(min(1.0, detection.width_px / LARGE_PX))
        score = detection.quality * size * (1 + WIDER_BONUS * number) * (GREY_SHARE if _is_grey(colour) else 1.0)
        score /= 1 + ELSEWHERE_COSTS * min(_area_elsewhere(colour.mask(frame.image), detection), MAX_ELSEWHERE)
        yield _Range(score, colour)


def _is_grey(colour: HsvRange) -> bool:
    return (colour.lower[0], colour.upper[0]) == (0, 179)


def _area_elsewhere(mask: Mask, detection: Detection) -> float:
    """Return the area that has the colour beside the ball, as a share of the ball."""
    rest, ball_px2 = _mask_out(mask, detection)
    return cv2.countNonZero(rest) / ball_px2


def _mask_out(mask: Mask, detection: Detection) -> tuple[Mask, float]:
    """Return the mask without the ball, and the area of the ball; that is 0 if it was not found."""
    if detection.status is DetectionStatus.NOT_FOUND:
        return mask, 0.0
    rest, radius_px = mask.copy(), detection.width_px / 2
    centre = (round(detection.centre_px[0]), round(detection.centre_px[1]))
    cv2.circle(rest, centre, math.ceil(1.1 * radius_px) + 2, 0, cv2.FILLED)
    return rest, math.pi * radius_px**2


def view(frame: Frame, colour: HsvRange, detect: Detect) -> ColourView:
    """Return the view that a range of colours gives of a frame."""
    detection, mask = detect(frame, colour), colour.mask(frame.image)
    return ColourView(detection=detection, mask=mask, others=_list_others(mask, detection, THING_SHARE))


def _list_others(mask: Mask, detection: Detection, share: float) -> tuple[RejectedCandidate, ...]:
    """List the other things that have the colour and are not too small beside the ball, the largest first."""
    rest, ball_px2 = _mask_out(mask, detection)
    _, _, stats, centres = cv2.connectedComponentsWithStats(rest, connectivity=8)
    areas = stats[1:, cv2.CC_STAT_AREA]
    largest = [1 + int(each) for each in np.argsort(-areas) if areas[each] >= max(THING_PX2, share * ball_px2)]
    sizes = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1)
    return tuple(
        RejectedCandidate(
            centre_px=(float(centres[label, 0]), float(centres[label, 1])),
            size_px=float(sizes[label]),
            reason="has the colour as well",
        )
        for label in largest[:MAX_THINGS]
    )


def _find_hue_margin(samples: Sequence[ColourSample], views: Sequence[ColourView], colour: HsvRange) -> int | None:
    """Return by how many hues the range can grow at both ends before it covers something else; None for many."""
    before = [len(_list_others(view.mask, view.detection, MARGIN_SHARE)) for view in views]
    for hues in range(2, MAX_HUE_MARGIN + 1, 2):
        wider = widen(colour, hues)
        masks = (wider.mask(frame.image) for frame, _ in samples)
        after = [len(_list_others(mask, view.detection, MARGIN_SHARE)) for mask, view in zip(masks, views, strict=True)]
        if any(now > own for now, own in zip(after, before, strict=True)):
            return hues - 2
    return None


class _VividBlob(NamedTuple):
    """A blob with a colour of its own.

    Attributes:
        score: How much it looks like a ball: round, unlike its surroundings, vivid, large.
        place: The pixel that is deepest in it.
        radius_px: The radius of the smallest circle around it.
    """

    score: float
    place: Place
    radius_px: float


def _pick_vivid(image: Image, most: int) -> list[_VividBlob]:
    """Return the blobs that look most like a ball, the best first; none of them in another."""
    scale = min(1.0, SEARCH_WIDTH_PX / max(image.shape[:2]))
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else image
    calm = cv2.GaussianBlur(small, (0, 0), 1.0)
    hsv, lab = cv2.cvtColor(calm, cv2.COLOR_BGR2HSV), cv2.cvtColor(calm, cv2.COLOR_BGR2LAB)
    chroma = cv2.multiply(cv2.extractChannel(hsv, 1), cv2.extractChannel(hsv, 2), scale=1 / 255)
    chosen: list[_VividBlob] = []
    for blob in sorted(_find_vivid(hsv, lab, chroma), reverse=True):
        if all(math.dist(blob.place, other.place) > OVERLAP * max(blob.radius_px, other.radius_px) for other in chosen):
            chosen.append(blob)
        if len(chosen) == most:
            break
    larger = 1 / scale
    return [
        _VividBlob(score, ((x_px + 0.5) * larger - 0.5, (y_px + 0.5) * larger - 0.5), radius_px * larger)
        for score, (x_px, y_px), radius_px in chosen
    ]


def _find_vivid(hsv: cv2.typing.MatLike, lab: cv2.typing.MatLike, chroma: cv2.typing.MatLike) -> Iterator[_VividBlob]:
    hue = hsv[..., 0].astype(np.int16)
    for middle in range(0, 180, HUES_APART):
        is_near = np.abs((hue - middle + 90) % 180 - 90) <= HUE_REACH
        for least in CHROMA_LEVELS:
            mask = np.asarray(is_near & (chroma >= least), np.uint8)
            mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), np.uint8)
            _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
            largest = 1 + np.argsort(-stats[1:, cv2.CC_STAT_AREA])[:MAX_BLOBS_PER_HUE]
            for label in largest.tolist():
                if AREA_PX2 <= stats[label, cv2.CC_STAT_AREA] <= MAX_PICTURE_SHARE * mask.size:
                    yield _rate_blob(labels == label, stats[label], lab, chroma)


def _rate_blob(is_in: np.ndarray, stats: np.ndarray, lab: cv2.typing.MatLike, chroma: cv2.typing.MatLike) -> _VividBlob:
    x, y, width, height = (int(each) for each in stats[: cv2.CC_STAT_AREA])
    margin = RING_PX + 2
    top, left = max(0, y - margin), max(0, x - margin)
    part = (slice(top, y + height + margin), slice(left, x + width + margin))
    patch = is_in[part].astype(np.uint8)
    outlines, _ = cv2.findContours(patch, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(outlines, key=len)
    _, radius_px = cv2.minEnclosingCircle(outline)
    hull_px2 = cv2.contourArea(cv2.convexHull(outline))
    filled = min(1.0, (cv2.contourArea(outline) + len(outline) / 2) / (hull_px2 + 1))
    roundness = filled * hull_px2 / (math.pi * (radius_px + 0.5) ** 2)
    near = cv2.dilate(patch, np.ones((3, 3), np.uint8))
    ring = cv2.dilate(patch, np.ones((2 * RING_PX + 1,) * 2, np.uint8)) > near
    inside = np.median(lab[part][patch > 0], axis=0)
    outside = np.median(lab[part][ring], axis=0) if ring.any() else inside
    apart = math.hypot(*(inside - outside)[1:])
    vividness = math.sqrt(chroma[part][patch > 0].mean() / 255)
    depth = cv2.distanceTransform(cv2.copyMakeBorder(patch, 1, 1, 1, 1, cv2.BORDER_CONSTANT), cv2.DIST_L2, 3)
    row, column = divmod(int(np.argmax(depth)), depth.shape[1])
    return _VividBlob(
        score=roundness**2
        * math.log1p(apart / APART_LEVELS)
        * math.sqrt(min(radius_px, LARGE_BLOB_RADIUS_PX))
        * vividness,
        place=(left + column - 1.0, top + row - 1.0),
        radius_px=radius_px,
    )
