"""Finding objects: the network looks from time to time, and its boxes are followed in between.

**Where it looks.** In all of the picture, and every other time in a part of it at the resolution of its input: around a
thing that is small in the whole picture, in turn, and in tiles of the picture while there is nothing to follow
(`stadimeter.detectors.object.windows`). One look takes one run of the network, so that a live picture never waits for
more. A picture that follows on none gets a second one, around what was found; one from a file gets all of them.

**State.** A detector keeps no state, but this one remembers what it saw last (`Scene`, and nothing else): a network
takes 20 to 500 ms a picture, and what it saw, a pattern of corners, does not fit into a prediction. The rule is kept as
far as a recording needs it: answers follow from the frames and their capture times alone, and what is remembered is
used only for later frames of the same size. An earlier frame, or one of another size, is looked at as if there had been
none before.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.detection import Detection, DetectionStatus, Prediction, RejectedCandidate, Values
from stadimeter.core.frame import Frame, SensorBoxes
from stadimeter.detectors.object.families import PERSON_SIGMA_PX, Boxes, one_each, overlaps
from stadimeter.detectors.object.following import BoxPattern, BoxPlace, FollowedBox, follow_box, take_pattern
from stadimeter.detectors.object.network import Network
from stadimeter.detectors.object.windows import WORTHWHILE, InputSize, cut_by, part_around, tiles
from stadimeter.detectors.protocol import check_image
from stadimeter.detectors.sampling import REGION_SIGMAS, Region
from stadimeter.ranging.flat import KnownLength, UprightShape

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

# A box is of a thing that is followed from this overlap on; half a step of a person who walks across leaves more.
SAME_OVERLAP = 0.3

# A box found in a part of the picture is part of a larger one, an arm or a head, if that covers this share of it.
WITHIN_SHARE = 0.7

# A thing is worth a closer look where its pixels leave more than this share of the error that no pixels mend.
CLOSER_SHARE = 0.75

# In a picture from a file, the closer looks at things that were found.
MAX_CLOSER = 16

# The eyes of a face are this share of its box's height apart, or more: 0.36 in the median of 85 faces that look at the
# camera (CenterFace). 20 in profile had 0.02 to 0.25, but boxes of the same height. That height differs by 7 % among
# faces, and is taken to do so by some percent between profile and front.
TURNED_SHARE, TURNED_SIGMA = 0.33, 0.1

# A look counts as close as an earlier one at this share of its scale.
AS_CLOSE = 0.9

# One of several is looked for this far from where it is expected, as a share of its size, beside the prediction's own
# error: the middle of a box goes up and down and from side to side as arms and legs move.
NEAR_SHARE = 0.15

# So many more than are wanted are followed, since not all of them need be who is in the slots.
SPARE = 2

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
    """One box of the network, in pixels of the picture, moved and scaled to where it is in a later one.

    Attributes:
        boxes: The box as the network saw it, and nothing else.
        seen_at_s: When that picture was captured.
        pattern: What it is followed by; the reason if it cannot be.
        growth_sigma: Standard deviation of its growth since then, as a share.
        is_missed: Whether the network's last look at where it is did not see it; after two such looks it is gone.
    """

    boxes: Boxes
    place: BoxPlace
    seen_at_s: float
    pattern: BoxPattern | str
    growth_sigma: float = 0.0
    is_missed: bool = False

    @property
    def score(self) -> float:
        """The score that the network gave it, 0 to 1."""
        return float(min(max(self.boxes.scores[0], 0.0), 1.0))

    @property
    def corners(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom."""
        left, top, right, bottom = self.boxes.corners[0].tolist()
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

    def length_px(self, known: KnownLength) -> float:
        """Return the pixels that its known length takes."""
        left, top, right, bottom = self.corners
        if known == "eye_distance" and self.eyes is not None:
            return max(math.dist(*self.eyes), TURNED_SHARE * (bottom - top))
        return bottom - top if known == "height" else right - left

    def is_turned(self, known: KnownLength) -> bool:
        """Check whether it is a face that looks aside, so that the height of its box stands for its eyes."""
        return known == "eye_distance" and self.eyes is not None and math.dist(*self.eyes) < self.length_px(known)


class Scene(Struct, frozen=True, kw_only=True, eq=False):
    """The things in the newest picture, and what the network's last look was.

    Attributes:
        frame: The picture.
        looked_at_s: When the picture was captured in which the network looked last.
        looks: How often it has looked since a picture that followed on none.
        things: Those that it found, where they are now.
        doubtful: Boxes of low scores, and such as are too small, of the last look, the likeliest first.
        rejected: What was reported of others at the last look.
        lost: What could not be followed, where it was last: the network looks there in the next picture.
        why_none: Why nothing is known, where that is no finding of the network.
    """

    frame: Frame
    looked_at_s: float
    looks: int
    things: tuple[Thing, ...] = ()
    doubtful: tuple[Thing, ...] = ()
    rejected: tuple[RejectedCandidate, ...] = ()
    lost: tuple[Thing, ...] = ()
    why_none: str = ""

    @property
    def age_s(self) -> float:
        """The time since the last look."""
        return self.frame.captured_at_s - self.looked_at_s

    def precedes(self, frame: Frame) -> bool:
        """Check whether a frame follows on this one."""
        sizes = {(each.width_px, each.height_px) for each in (self.frame, frame)}
        return frame.captured_at_s > self.frame.captured_at_s and len(sizes) == 1


class ObjectDetector:
    """Finds one thing of a class by a network."""

    most = 1
    """Things that are followed between the looks of the network, at most."""

    def __init__(self, name: str, search: ObjectSearch) -> None:
        self._name = name
        self._search = search
        self._shape = search.shape
        self._loaded: LoadedNetwork | None = None
        self._scene: Scene | None = None

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
        before = self._scene
        scene = self._see(frame, prediction)
        if not scene.things:
            return self._nothing(scene)
        if scene.age_s > 0:
            return replace(self._report(scene.things[0], frame), rejected=scene.rejected)
        chosen, remark = self._choose(scene.things, prediction, before, frame)
        one, others = scene.things[chosen], (*scene.things[:chosen], *scene.things[chosen + 1 :])
        rejected = self._rejected(others, scene.doubtful)
        self._scene = replace(scene, things=(one, *others), rejected=rejected)
        return replace(self._report(one, frame, remark), rejected=rejected)

    # What is in a picture: the network looks, or what it saw is followed ----------------------------------------------

    def _see(self, frame: Frame, prediction: Prediction | None = None) -> Scene:
        """Return the scene of a frame, which for the frame before is the one that there is."""
        check_image(frame)
        scene = self._scene
        if scene is not None and scene.frame is frame:
            return scene
        if scene is not None and not scene.precedes(frame):
            scene = None
        since_s = math.inf if scene is None else frame.captured_at_s - scene.looked_at_s
        is_on_sensor = self._search.load is None
        is_asked = frame.boxes is not None if is_on_sensor else scene is not None and bool(scene.lost)
        if scene is None or is_asked or since_s >= self._search.every_s:
            self._scene = self._look(frame, scene, prediction)
        else:
            followed, lost, why = self._followed(frame, scene, prediction)
            self._scene = replace(scene, frame=frame, things=followed, lost=lost, why_none=why or scene.why_none)
        return self._scene

    def _look(self, frame: Frame, scene: Scene | None, prediction: Prediction | None) -> Scene:
        seen = Scene(frame=frame, looked_at_s=frame.captured_at_s, looks=1)
        if scene is not None:
            things, lost, _ = self._followed(frame, scene, prediction)
            seen = replace(seen, things=things, lost=(*scene.lost, *lost), looks=scene.looks + 1)
        load = self._search.load
        if load is None:
            if frame.boxes is None:
                why = "the camera has no result of a network with this picture: set network in [camera]"
                return replace(seen, things=(), lost=(), why_none=why)
            return self._take_in(seen, Region.whole(frame.image), self._of_sensor(frame, frame.boxes))
        loaded = self._loaded = self._loaded or load()
        size = InputSize(*loaded.network.input_px(frame.image))
        if scene is not None:
            return self._look_at(loaded, seen, self._part(seen, scene.doubtful, size))
        seen = self._look_at(loaded, seen, Region.whole(frame.image))
        for part in tiles(frame.image, size) if frame.source and len(seen.things) < self.most else ():
            seen = self._look_at(loaded, seen, part)
        doubtful = seen.doubtful if len(seen.things) < self.most else ()
        for thing in (*seen.things, *doubtful)[: MAX_CLOSER if frame.source else 1]:
            if self._is_small(thing, frame, size):
                seen = self._look_at(loaded, seen, part_around(np.array(thing.corners), frame.image, size))
        return seen

    def _part(self, seen: Scene, doubtful: tuple[Thing, ...], size: InputSize) -> Region:
        """Return where to look: everywhere, or closer at what was lost, small, doubtful, or not found yet."""
        image, is_odd = seen.frame.image, seen.looks % 2 == 0

        def around(things: tuple[Thing, ...]) -> tuple[Region, ...]:
            small = (each for each in things if self._is_small(each, seen.frame, size))
            return tuple(part_around(np.array(each.corners), image, size) for each in small)

        # Every other look is at all of the picture, whatever was lost: someone else may have come near.
        parts = around(seen.lost or seen.things) if is_odd else ()
        if len(parts) < len(seen.lost):  # a part of the picture shows not all of them
            parts = ()
        elif is_odd and not parts and len(seen.things) < self.most:
            parts = (*around(doubtful), *tiles(image, size))
        return parts[(seen.looks - 1) // 2 % len(parts)] if parts else Region.whole(image)

    def _is_small(self, thing: Thing, frame: Frame, size: InputSize) -> bool:
        """Check whether a closer look is worth it: pixels are what its error comes from, and there are more."""
        part = part_around(np.array(thing.corners), frame.image, size)
        scale = size.scale_of(part.right - part.left, part.bottom - part.top)
        whole = size.scale_of(frame.width_px, frame.height_px)
        few = self._sigma_px > CLOSER_SHARE * self._shape.box_sigma * whole * thing.length_px(self._shape.known)
        return few and scale > WORTHWHILE * whole and not self._cut_side(thing, frame)

    def _look_at(self, loaded: LoadedNetwork, scene: Scene, part: Region) -> Scene:
        """Let the network look at a part of the picture."""
        image, limit = scene.frame.image, NEARLY * self._search.min_score
        found = loaded.network.find(part.of(image), loaded.number, limit)
        shift = np.array((part.left, part.top))
        eyes = None if found.eyes is None else found.eyes + shift
        found = found._replace(corners=found.corners + np.tile(shift, 2), eyes=eyes)
        return self._take_in(scene, part, found.take(np.flatnonzero(~cut_by(part, found.corners, image, found.scale))))

    def _of_sensor(self, frame: Frame, found: SensorBoxes) -> Boxes:
        is_meant = np.array(found.classes, object) == self._search.class_name
        which = np.flatnonzero(is_meant & (found.scores >= NEARLY * self._search.min_score))
        scale = found.input_px / max(frame.width_px, frame.height_px)
        return one_each(Boxes(found.corners_px, found.scores, scale=scale).take(which))

    def _take_in(self, scene: Scene, part: Region, found: Boxes) -> Scene:
        """Join what the network finds in a part of the picture with what is there already.

        Of two boxes of one thing the more exact one stays. A thing is gone if the network looked where it is, as
        closely as when it saw it, and does not see it, twice in a row: they miss some people now and then.
        """
        is_whole = part == Region.whole(scene.frame.image)
        known, things, doubtful = list(scene.things), [], list(scene.doubtful)
        for index in range(len(found.scores)):
            box = found.take(np.array([index]))
            short_px = float((box.corners[0, 2:] - box.corners[0, :2]).min())
            is_likely = box.scores[0] >= self._search.min_score and short_px >= MIN_SIDE_PX
            thing = self._first(box, scene.frame, is_likely=bool(is_likely))
            same = max(known, key=lambda each: _overlap(each, thing), default=None)
            if not is_likely:
                doubtful.append(thing)
            elif same is not None and _overlap(same, thing) >= SAME_OVERLAP:
                known.remove(same)
                at_s = scene.frame.captured_at_s
                best = min(thing, same, key=lambda each: self._noise_share(each, at_s))
                things.append(replace(best, is_missed=False))
            elif is_whole or not _is_within(thing, (*scene.things, *things)):
                things.append(thing)
        missed = [
            each
            for each in known
            if _should_show(part, each, found.scale, scene.frame)
            # What was cut off has left, or is seen anew in the whole picture; no closer look is taken at it.
            or (is_whole and each.seen_at_s < scene.frame.captured_at_s and self._cut_side(each, scene.frame))
        ]
        things += [each for each in known if each not in missed]
        things += [replace(each, is_missed=True) for each in missed if not each.is_missed]
        things.sort(key=lambda each: -each.length_px(self._shape.known))
        left = [each for each in doubtful if not any(_overlap(each, thing) >= SAME_OVERLAP for thing in things)]
        left.sort(key=lambda each: -each.score)
        return replace(scene, things=tuple(things), doubtful=tuple(left), lost=())

    def _first(self, box: Boxes, frame: Frame, *, is_likely: bool) -> Thing:
        """Return a box where the network sees it; what is not likely is not followed."""
        x, y = ((box.corners[0, :2] + box.corners[0, 2:]) / 2).tolist()
        pattern = take_pattern(frame.image, box.corners[0]) if is_likely else ""
        return Thing(boxes=box, place=BoxPlace((x, y)), seen_at_s=frame.captured_at_s, pattern=pattern)

    def _followed(
        self, frame: Frame, scene: Scene, prediction: Prediction | None
    ) -> tuple[tuple[Thing, ...], tuple[Thing, ...], str]:
        """Return where things are now, those of which that is not known, and why."""
        kept, lost, why = [], [], ""
        for thing in scene.things[: self.most]:
            if self._cut_side(thing, frame):  # it would be taken for whole further inside
                kept.append(thing)
                continue
            followed: FollowedBox | str = thing.pattern if isinstance(thing.pattern, str) else ""
            for near in _starts(thing, prediction):
                if isinstance(thing.pattern, BoxPattern) and not isinstance(followed, FollowedBox):
                    followed = follow_box(frame.image, thing.pattern, near)
            if isinstance(followed, FollowedBox):
                kept.append(replace(thing, place=followed.place, growth_sigma=followed.growth_sigma))
            else:
                lost.append(thing)
                why = f"the {self._what} is not followed until the network looks again: {followed}"
        return tuple(kept), tuple(lost), why

    # Which one is meant, and what is said of it -----------------------------------------------------------------------

    def _choose(
        self, things: tuple[Thing, ...], prediction: Prediction | None, before: Scene | None, frame: Frame
    ) -> tuple[int, str]:
        """Return which of some things is meant, and a remark if there was a choice.

        One track stands for all, so the one that is followed gives way to one that is surely nearer: an alarm on a
        person must not be late since another one, farther away, was seen first.
        """
        count = len(things)
        if count == 1:
            return 0, ""
        whole = np.array([not self._cut_side(each, frame) for each in things])
        known = np.array([each.length_px(self._shape.known) for each in things])
        corners = np.array([each.corners for each in things])
        expected = self._expected(corners, prediction, before, frame)
        if expected is None:
            areas = (corners[:, 2:] - corners[:, :2]).prod(axis=1)
            return int(np.where(whole, areas, areas * 1e-9).argmax()), f"the largest of {count} in view"
        nearest = int(np.where(whole, known, 0.0).argmax())
        at_s = frame.captured_at_s
        both = math.hypot(*(self._noise_share(things[each], at_s) for each in (nearest, expected)))
        if whole[nearest] and known[nearest] > (1 + NEARER_SIGMAS * both) * known[expected]:
            return nearest, f"the nearest of {count}"
        return expected, f"the one of {count} where it was expected"

    def _expected(
        self, corners: Values, prediction: Prediction | None, before: Scene | None, frame: Frame
    ) -> int | None:
        """Return the box nearest to where the one that is followed should be, or was of late; None where none is."""
        place = None if prediction is None else prediction.centre_px
        if place is None and before is not None and before.things and (before.frame is frame or before.precedes(frame)):
            is_recent = frame.captured_at_s - before.looked_at_s <= self._search.every_s + MEANT_FOR_S
            place = before.things[0].place.centre_px if is_recent else None
        if place is None:
            return None
        return int(np.abs((corners[:, :2] + corners[:, 2:]) / 2 - place).max(axis=1).argmin())

    @property
    def _sigma_px(self) -> float:
        return self._loaded.network.sigma_px if self._loaded else PERSON_SIGMA_PX

    def _noise_share(self, thing: Thing, at_s: float) -> float:
        """Return the standard deviation of its known length that differs from look to look, as a share."""
        seen_px = thing.length_px(self._shape.known) / thing.place.growth * thing.boxes.scale
        since = math.hypot(SIGMA_PER_S * (at_s - thing.seen_at_s), thing.growth_sigma)
        turned = TURNED_SIGMA if thing.is_turned(self._shape.known) else 0.0
        return math.hypot(self._shape.box_sigma / math.sqrt(2), self._sigma_px / seen_px, since, turned)

    def _report(self, thing: Thing, frame: Frame, remark: str = "") -> Detection:
        left, top, right, bottom = thing.corners
        width_px, height_px = right - left, bottom - top
        centre = thing.place.centre_px
        known_px = thing.length_px(self._shape.known)
        if self._shape.known == "eye_distance" and thing.eyes is not None:
            (x, y), (other_x, other_y) = thing.eyes
            width_px = height_px = known_px
            centre = (x + other_x) / 2, (y + other_y) / 2
            if thing.is_turned(self._shape.known):
                remark = "; ".join(filter(None, (remark, "looks aside: measured by the height of its box")))
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
            size_sigma_px=known_px * self._noise_share(thing, frame.captured_at_s),
            quality=thing.score,
        )

    def _cut_side(self, thing: Thing, frame: Frame) -> str:
        """Return the border that may cut off the known length of a thing; an empty string if none does."""
        left, top, right, bottom = thing.corners
        margin_px = max(BORDER_PX, BORDER_SHARE * max(right - left, bottom - top))
        is_by_eyes = self._shape.known == "eye_distance" and not thing.is_turned(self._shape.known)
        if is_by_eyes and thing.eyes is not None:
            (left, top), (right, bottom) = np.min(thing.eyes, axis=0), np.max(thing.eyes, axis=0)
        across = {"left": left < margin_px, "right": right > frame.width_px - 1 - margin_px}
        down = {"top": top < margin_px, "bottom": bottom > frame.height_px - 1 - margin_px}
        sides = {"height": down, "width": across, "eye_distance": {**across, **down}}[self._shape.known]
        return " and ".join(name for name, is_cut in sides.items() if is_cut)

    def _rejected(self, others: tuple[Thing, ...], doubtful: tuple[Thing, ...]) -> tuple[RejectedCandidate, ...]:
        found = [(each.corners, f"is another {self._what}, score {each.score:.2f}") for each in others]
        for each in doubtful:
            why = f"scores {each.score:.2f}, limit {self._search.min_score:g}"
            if each.score >= self._search.min_score:
                left, top, right, bottom = each.corners
                why = f"has a side of {min(right - left, bottom - top):.1f} px, limit {MIN_SIDE_PX:g} px"
            found.append((each.corners, why))
        return tuple(
            RejectedCandidate(
                centre_px=((left + right) / 2, (top + bottom) / 2),
                size_px=max(right - left, bottom - top),
                reason=why,
                corners_px=((left, top), (right, top), (right, bottom), (left, bottom)),
            )
            for (left, top, right, bottom), why in found[:MAX_REJECTED]
        )

    def _nothing(self, scene: Scene) -> Detection:
        """Report that there is none."""
        rejected = self._rejected((), scene.doubtful)
        best = f": the likeliest box {rejected[0].reason}" if rejected else ""
        since = f", when the network last looked, {scene.age_s:.2f} s before" if scene.age_s > 0 else ""
        reason = scene.why_none or f"no {self._what}{best}{since}"
        return Detection(target=self._name, status=DetectionStatus.NOT_FOUND, reason=reason, rejected=rejected)


class SeveralObjects(ObjectDetector):
    """Finds every thing of a class, as many as there are.

    Args:
        count: How many are wanted at most.
    """

    numbers: tuple[int, ...] = ()
    """None: they are all alike."""

    def __init__(self, name: str, search: ObjectSearch, count: int) -> None:
        super().__init__(name, search)
        self.most = count + SPARE

    def detect_all(self, frame: Frame, *, lens: CameraModel | None = None) -> tuple[Detection, ...]:  # noqa: ARG002
        """Return all that are in sight."""
        scene = self._see(frame)
        return tuple(self._report(each, frame) for each in scene.things) or (self._nothing(scene),)

    def detect_near(
        self,
        frame: Frame,
        prediction: Prediction,
        *,
        lens: CameraModel | None = None,  # noqa: ARG002
    ) -> Detection:
        """Return the one that is nearest to the prediction."""
        reach_px = REGION_SIGMAS * prediction.sigma_px + NEAR_SHARE * prediction.size_px
        away = [(math.dist(each.place.centre_px, prediction.centre_px), each) for each in self._see(frame).things]
        off_px, thing = min(away, key=lambda each: each[0], default=(math.inf, None))
        if thing is None or not off_px <= reach_px:
            reason = f"no {self._what} is where one was expected"
            return Detection(target=self._name, status=DetectionStatus.NOT_FOUND, reason=reason)
        return self._report(thing, frame)


def _overlap(one: Thing, other: Thing) -> float:
    return float(overlaps(np.array(one.corners), np.array([other.corners]))[0])


def _is_within(thing: Thing, others: tuple[Thing, ...]) -> bool:
    """Check whether a box is part of a larger one."""
    one = np.array(thing.corners)
    for each in others:
        other = np.array(each.corners)
        common = (np.minimum(one[2:], other[2:]) - np.maximum(one[:2], other[:2])).clip(0).prod()
        if common >= WITHIN_SHARE * (one[2:] - one[:2]).prod():
            return True
    return False


def _should_show(part: Region, thing: Thing, scale: float, frame: Frame) -> bool:
    """Check whether a thing that was seen before would be seen in a part of the picture at this scale, if it was there.

    What another look at the same picture saw is there. Near the border of a part a network may miss what is there.
    """
    if thing.seen_at_s == frame.captured_at_s or scale < AS_CLOSE * thing.boxes.scale:
        return False
    if part == Region.whole(frame.image):
        return True
    # From each side of the part that is none of the picture, a quarter of the part away.
    (x, y), quarter = thing.place.centre_px, (part.right - part.left) / 4
    inside = (
        part.left == 0 or x - part.left >= quarter,
        part.top == 0 or y - part.top >= quarter,
        part.right == frame.width_px or part.right - x >= quarter,
        part.bottom == frame.height_px or part.bottom - y >= quarter,
    )
    return all(inside) and not cut_by(part, np.array([thing.corners]), frame.image, scale)[0]


def _starts(thing: Thing, prediction: Prediction | None) -> list[BoxPlace]:
    """Return where to look for a box: where it is expected, if that may be, and where it was last."""
    last = thing.place
    left, _, right, _ = thing.corners
    if prediction is None or not math.dist(prediction.centre_px, last.centre_px) < right - left:
        return [last]
    return [BoxPlace(prediction.centre_px, last.growth), last]
