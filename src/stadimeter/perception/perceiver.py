"""From a frame and the tracks to measurements: the lens scaled, each target looked for where it is expected, measured.

Around a prediction a detector looks at a small part of the picture only, which takes a fraction of the time. Its answer
there is final, so something that was once mistaken for the target could hold its place for ever, while the target is in
plain sight elsewhere. So from time to time the whole frame is searched, as if nothing was known.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.core.camera_model import CameraModel
from stadimeter.core.camera_pose import Footing
from stadimeter.core.detection import Detection, DetectionStatus, Points, Prediction, TargetShape
from stadimeter.core.frame import Frame, Optics
from stadimeter.core.measurement import Measurement, Track, TrackStatus
from stadimeter.detectors.protocol import Detector, TracksSeveral
from stadimeter.perception import prediction
from stadimeter.ranging.flat import UprightShape
from stadimeter.ranging.floor import stand
from stadimeter.ranging.measure import SeenTarget, measure, unmeasured

if TYPE_CHECKING:  # most runs have one camera
    from stadimeter.perception.second_camera import SecondView


# Several targets of one kind: one detector finds them all, and each keeps its slot for as long as it is followed ------
#
# In each frame every member that is followed is looked for where it is expected, the nearest first, as a single
# target is. The detections are then shared out by place and size, the likeliest first (`assign`). The whole
# frame is searched once for all of them: once a second, more often while slots are free, and at once when a member
# is gone.
#
# A member whose expected place is covered by a nearer one is hidden. It is not looked for, so that it cannot take
# the other's detection, and its motion goes on: where it comes out again, it is the same one. After `REMEMBERED_S`,
# or in a slot that a newcomer got meanwhile, it is forgotten.

# Assignment: the likeliest pair first, then the likeliest of those that are left. Of all ways together the likeliest is
# another one now and then, but in 20 scenes of people and 8 of balls who cross, both gave the same names.


def assign(costs: Sequence[Sequence[float]], unassigned: float) -> list[int | None]:
    """Return for each row the column that it gets, or None; no column twice, and those of the least cost first.

    Args:
        costs: For each row the cost of each column; infinite for what must not be.
        unassigned: The cost of a row without a column.
    """
    given: list[int | None] = [None] * len(costs)
    pairs = ((cost, row, column) for row, each in enumerate(costs) for column, cost in enumerate(each))
    for _, row, column in sorted(pair for pair in pairs if pair[0] < unassigned):
        if given[row] is None and column not in given:
            given[row] = column
    return given


# Looking for all of them in one frame ---------------------------------------------------------------------------------

# With a free slot the whole frame is searched this often, so that a newcomer is seen soon.
FREE_EVERY_S = 0.25

# A detection whose place and size are further from what was expected than 4 standard deviations, all three together,
# is of something else: of a member's own detections that is 1 in 1000.
GATE2 = 16.0

# Standard deviation of the apparent size, as a share of it: that of a ball half covered; something flat also turns.
# What stands upright does not; beside the error of its box, people bend and stretch by this.
SIZE_SHARE, SIZE_SHARE_FLAT, POSTURE_SHARE = 0.06, 0.3, 0.05

# Costs are −2 ln of likelihoods. The worst that the gate lets through is 16 + 4 ln 160 + 2 ln 60 = 44: no pair that is
# possible costs more than a member left without.
UNASSIGNED = 50.0

# Of a ball that overlaps with a nearer one, the place errs by as much as this share of its size; of any other, by less.
PLACE_SHARE, PLACE_SHARE_COVERED = 0.06, 0.15

# Two detections whose centres are nearer than this share of the larger size are one thing.
SAME_SHARE = 0.25


class Several:
    """Looks for the targets of one kind in one run."""

    def __init__(self, names: Sequence[str], detector: TracksSeveral) -> None:
        numbers = detector.numbers or (None,) * len(names)
        self._slots = [_Slot(name, number) for name, number in zip(names, numbers, strict=True)]
        self._detector = detector
        self._searched_at_s = -math.inf

    def look(self, frame: Frame, lens: CameraModel, tracks: Mapping[str, Track]) -> dict[str, Detection]:
        """Look for all of them; return a detection for each name.

        Args:
            tracks: What is known of each, by name.
        """
        at_s, slots = frame.captured_at_s, self._slots
        shape = self._detector.target_shape
        expected = [slot.expect(tracks.get(slot.name), shape, lens, at_s) for slot in slots]
        scan = _Scan(self._detector, frame, lens, slots, expected)
        scan.look_near()
        scan.share_out()
        if self._is_due(at_s, expected) or scan.has_lost_one():
            self._searched_at_s = at_s
            scan.look_everywhere()
            scan.share_out()
            scan.let_newcomers_in()
        return {slot.name: scan.answer(index, at_s) for index, slot in enumerate(slots)}

    def _is_due(self, at_s: float, expected: Sequence[Prediction | None]) -> bool:
        """Check whether the whole frame is to be searched; in time of capture, as for a single target."""
        every_s = FREE_EVERY_S if None in expected else prediction.SEARCH_EVERY_S
        return not 0 <= at_s - self._searched_at_s < every_s or not any(expected)


class _Slot:
    """The place of one member, and what is remembered of who is in it."""

    def __init__(self, name: str, number: int | None) -> None:
        self.name = name
        self.is_fixed = number is not None
        self.number = number
        self.is_followed = False
        self.is_new = False  # whether it was seen, and is not tracked yet
        self.is_covered = False  # whether it overlaps with a nearer one
        self._track: Track | None = None
        self._motion: prediction.AngularMotion | None = None
        self._seen: tuple[Detection, float] | None = None

    def expect(self, track: Track | None, shape: TargetShape, lens: CameraModel, at_s: float) -> Prediction | None:
        """Return where the member will appear; None if the slot is empty, or that is not known."""
        self.is_followed = track is not None and track.is_valid
        self.is_covered = self.is_new = False
        motion = None if track is None else prediction.follow(self._motion, track, shape)
        if motion is not None:
            self._track, self._motion = track, motion
        if self._track is not None:
            # A track that was lost behind another member goes on here: its figures are the last ones known.
            kept = replace(self._track, status=TrackStatus.COASTING)
            expected = prediction.predict(kept, shape, lens, at_s, self._motion, is_remembered=True)
            if expected is not None:
                return expected
        if self._seen is not None and 0 <= at_s - self._seen[1] <= prediction.UNSEEN_MAX_S:
            self.is_new = True
            return _near_last(*self._seen, shape, lens, at_s)
        return None

    @property
    def last_seen(self) -> Detection | None:
        """The last sight of it."""
        return self._seen[0] if self._seen else None

    def take(self, found: Detection, at_s: float) -> None:
        """Note what was found of the member."""
        self._seen = (found, at_s)
        if not self.is_fixed:
            self.number = found.number

    def clear(self) -> None:
        """Forget who was here."""
        self._track = self._motion = self._seen = None
        if not self.is_fixed:
            self.number = None


class _Scan:
    """Looks for the members in one frame."""

    def __init__(
        self,
        detector: TracksSeveral,
        frame: Frame,
        lens: CameraModel,
        slots: Sequence[_Slot],
        expected: Sequence[Prediction | None],
    ) -> None:
        self._detector, self._frame, self._lens = detector, frame, lens
        self._slots, self._expected = slots, expected
        self._found: list[Detection] = []
        self._of: list[int | None] = [None] * len(slots)  # for each slot, which of what was found is its member
        self._why: dict[int, Detection] = {}  # for slots whose member was not found, what was seen instead
        self._nothing: Detection | None = None

    def look_near(self) -> None:
        """Look for each member where it is expected, the nearest, so largest, first; not for one that is hidden."""
        members = [(index, each) for index, each in enumerate(self._expected) if each is not None]
        nearer: list[tuple[str, _Ellipse]] = []  # those before
        for index, each in sorted(members, key=lambda member: -member[1].size_px):
            slot, radius_px = self._slots[index], each.size_px / 2
            gap_px, before = min(((one.gap_px(each.centre_px), name) for name, one in nearer), default=(math.inf, ""))
            slot.is_covered = gap_px < radius_px
            if gap_px < 0:  # its centre is covered: what is found there is the other one
                reason = f"hidden behind {before}"
                self._why[index] = Detection(target=slot.name, status=DetectionStatus.NOT_FOUND, reason=reason)
                continue
            found = self._detector.detect_near(self._frame, each, lens=self._lens)
            if found.status is DetectionStatus.FOUND or (slot.is_followed and found.is_whole):
                self._add(found)
                nearer.append((slot.name, _Ellipse(found.centre_px, self._size_px(found), found)))
            else:
                self._why[index] = found
                if slot.is_followed:
                    nearer.append((slot.name, _Ellipse(each.centre_px, each.size_px, slot.last_seen)))

    def look_everywhere(self) -> None:
        """Search the whole frame."""
        for found in self._detector.detect_all(self._frame, lens=self._lens):
            if found.status is DetectionStatus.FOUND:
                self._add(found)
            elif self._nothing is None:
                self._nothing = found

    def share_out(self) -> None:
        """Give each member the detection that is its own."""
        # One that the border cuts off is there, though it has no size, and is none of the others.
        members = [i for i, each in enumerate(self._expected) if each is not None and not self._is_cut_off(i)]
        costs = [[self._cost(index, found) for found in self._found] for index in members]
        self._of = [None] * len(self._slots)
        for index, which in zip(members, assign(costs, UNASSIGNED), strict=True):
            self._of[index] = which

    def has_lost_one(self) -> bool:
        """Check whether a member that is followed or new is gone: not found, nor behind another one, nor cut off."""
        return any(
            (slot.is_followed or slot.is_new)
            and self._of[index] is None
            and self._expected[index] is not None
            and not slot.is_covered
            and not self._is_cut_off(index)
            for index, slot in enumerate(self._slots)
        )

    def _is_cut_off(self, index: int) -> bool:
        return index in self._why and self._why[index].status is DetectionStatus.TRUNCATED

    def let_newcomers_in(self) -> None:
        """Give what belongs to no member to free slots, the largest first; slots with none to remember go first."""
        free = [index for index, slot in enumerate(self._slots) if self._of[index] is None and not slot.is_followed]
        free.sort(key=lambda index: self._expected[index] is not None)
        left = [index for index in range(len(self._found)) if index not in self._of]
        for which in sorted(left, key=lambda index: -self._size_px(self._found[index])):
            number = self._found[which].number
            fits = (index for index in free if not self._slots[index].is_fixed or self._slots[index].number == number)
            slot = next(fits, None)
            if slot is not None:
                free.remove(slot)
                self._slots[slot].clear()
                self._of[slot] = which

    def answer(self, index: int, at_s: float) -> Detection:
        """Report what was found of a slot's member, or why it was not."""
        slot, which = self._slots[index], self._of[index]
        if which is not None:
            slot.take(self._found[which], at_s)
            return replace(self._found[which], target=slot.name)
        if (why := self._why.get(index)) is not None:
            return replace(why, target=slot.name)
        if (nothing := self._nothing) is not None:
            self._nothing = replace(nothing, rejected=())  # what was rejected is reported once
            return replace(nothing, target=slot.name)
        return Detection(target=slot.name, status=DetectionStatus.NOT_FOUND, reason="no other one is in sight")

    def _add(self, found: Detection) -> None:
        """Note a detection, unless it is one that is known already."""
        if not any(self._are_one(found, known) for known in self._found):
            self._found.append(found)

    def _are_one(self, one: Detection, other: Detection) -> bool:
        if one.number != other.number:
            return False
        return math.dist(one.centre_px, other.centre_px) < SAME_SHARE * max(self._size_px(one), self._size_px(other))

    def _size_px(self, found: Detection) -> float:
        return _size_px(found, self._detector.target_shape)

    def _cost(self, index: int, found: Detection) -> float:
        """Return −2 ln of the likelihood that a detection is a slot's member; infinite beyond the gate.

        A Gaussian of place (both ways) and size: the normalised squared distance, and the logarithm of the variances,
        without which a member that may be anywhere would fit best everywhere.
        """
        expected, number = self._expected[index], self._slots[index].number
        if expected is None or (number is not None and found.number != number):
            return math.inf
        if number is not None:
            return -UNASSIGNED  # its number says so
        size_px = expected.size_px
        shape = self._detector.target_shape
        is_upright = isinstance(shape, UprightShape) and shape.known == "height"
        errs = PLACE_SHARE_COVERED if self._slots[index].is_covered and not is_upright else PLACE_SHARE
        place_px = math.hypot(expected.sigma_px, errs * size_px)
        # Along the line of sight it may have moved as far as across: as a share of the distance that is the angle.
        moved = place_px / math.sqrt(self._lens.fx_px * self._lens.fy_px)
        share = SIZE_SHARE_FLAT if shape.has_corners else SIZE_SHARE
        if is_upright:
            share = math.hypot(POSTURE_SHARE, found.size_sigma_px / self._size_px(found))
        of_size_px = math.hypot(prediction.FLOOR_PX, size_px * share, size_px * moved)
        off2 = (math.dist(expected.centre_px, found.centre_px) / place_px) ** 2
        off2 += ((self._size_px(found) - size_px) / of_size_px) ** 2
        return off2 + 4 * math.log(place_px) + 2 * math.log(of_size_px) if off2 <= GATE2 else math.inf


def _near_last(found: Detection, seen_at_s: float, shape: TargetShape, lens: CameraModel, at_s: float) -> Prediction:
    """Return where what was seen once, and is not tracked yet, may be now."""
    focal_px, size_px = math.sqrt(lens.fx_px * lens.fy_px), _size_px(found, shape)
    moved_rad = prediction.loose_radps(shape.longest_m * focal_px / size_px) * (at_s - seen_at_s)
    sigma_px = math.hypot(prediction.FLOOR_PX, SIZE_SHARE * size_px, focal_px * moved_rad)
    return Prediction(centre_px=found.centre_px, size_px=size_px, sigma_px=sigma_px)


class _Ellipse(NamedTuple):
    """The outline of a target, as long and as wide as it was seen."""

    centre_px: tuple[float, float]
    size_px: float
    seen: Detection | None

    def gap_px(self, place_px: tuple[float, float]) -> float:
        """Return the distance of a place from it, with its shorter side stretched to the longer one; below 0 inside."""
        across, down = (1.0, 1.0) if self.seen is None else (self.seen.width_px, self.seen.height_px)
        longer = max(across, down)
        off_x, off_y = (there - here for there, here in zip(place_px, self.centre_px, strict=True))
        return math.hypot(off_x * longer / max(across, 1e-6), off_y * longer / max(down, 1e-6)) - self.size_px / 2


def _size_px(found: Detection, shape: TargetShape) -> float:
    """Return the apparent size of a target, by the length that predictions are of."""
    if isinstance(shape, UprightShape):
        return max(found.height_px if shape.known == "height" else found.width_px, prediction.FLOOR_PX)
    return max(found.width_px, found.height_px, prediction.FLOOR_PX)


# Motion blur of the targets of a run, and the exposure that avoids it -------------------------------
#
# A target that moves at v pixels a second is smeared by b = v·t while it is exposed for t. Measured on rendered
# pictures, smeared along one side, of targets of s pixels: up to b/s = 0.03 distances are off by 0.5 % at most; at
# 0.1 those of a ball by -0.6 %, of a sheet by 0.7 %, of a tag by -3.5 %. Beyond that a sheet's may be off by 13 %,
# and targets are lost.

# A target is blurred by motion if it is smeared by more than this share of its size, and by more than this.
BLURRED_SHARE = 0.03
BLURRED_PX = 1.0

# The exposure that is advised leaves a smear of this share: less cannot be seen in the distance.
WANTED_SHARE = 0.02

# Blur is worth a word in more than this share of the sightings, and if it was seen this often.
BLURRED_OF_SIGHTINGS = 0.05
SIGHTINGS_MIN = 5

# The exposure is advised for what is blurred less than the worst tenth of the blurred sightings.
SPEED_PERCENTILE = 0.9

# Two sightings further apart than this do not tell a speed.
APART_MAX_S = 0.2

KEPT = 500


class _Smear(NamedTuple):
    share: float  # of the target's size
    smear_px: float
    speed_mps: float  # across the line of sight, of target and camera together
    exposure_s: float


class _Sighting(NamedTuple):
    captured_at_s: float
    found: Detection


class _Watched(Struct):
    last: _Sighting | None = None
    sightings: int = 0
    blurred: int = 0
    smears: deque[_Smear] = field(default_factory=lambda: deque(maxlen=KEPT))  # the newest blurred ones


class MotionBlur:
    """Watches the targets of a run, in frames of known exposure; others are left out."""

    def __init__(self) -> None:
        self._targets: dict[str, _Watched] = {}

    def add(self, frame: Frame, found: Detection, measured: Measurement, focal_px: float) -> None:
        """Take in where a target is in a frame.

        Args:
            focal_px: The focal length at the frame's resolution.
        """
        if frame.exposure_s is None:
            return
        watched = self._targets.setdefault(measured.target, _Watched())
        before, watched.last = watched.last, None
        if measured.depth_m is None:
            return
        watched.last = _Sighting(frame.captured_at_s, found)
        speed_px_s = _speed_px_s(before, watched.last)
        if speed_px_s is None:
            return
        watched.sightings += 1
        # b = v t in pixels; held against the smaller side, which the distance suffers most on.
        smear_px = speed_px_s * frame.exposure_s
        share = smear_px / max(1.0, min(found.width_px, found.height_px))
        if share > BLURRED_SHARE and smear_px > BLURRED_PX:
            watched.blurred += 1
            speed_mps = speed_px_s * measured.depth_m / focal_px
            watched.smears.append(_Smear(share, smear_px, speed_mps, frame.exposure_s))

    def advice(self) -> tuple[str, ...]:
        """Return a sentence on each target that motion blurs, with the exposure to write; nothing if none is."""
        return tuple(
            _advice(target, watched)
            for target, watched in self._targets.items()
            if watched.blurred >= max(SIGHTINGS_MIN, BLURRED_OF_SIGHTINGS * watched.sightings)
        )


def _speed_px_s(before: _Sighting | None, now: _Sighting) -> float | None:
    """Return the speed of the edges of a target in the picture: its centre, and half of what its size changes by."""
    if before is None or before.found.number != now.found.number:
        return None
    apart_s = now.captured_at_s - before.captured_at_s
    if not 0 < apart_s <= APART_MAX_S:
        return None
    # An approach moves opposite edges apart: each by half of what the size grows.
    grown_px = max(abs(now.found.width_px - before.found.width_px), abs(now.found.height_px - before.found.height_px))
    return (math.dist(now.found.centre_px, before.found.centre_px) + grown_px / 2) / apart_s


def _advice(target: str, watched: _Watched) -> str:
    # Sorted by share of the size. Smear is proportional to exposure, so the wanted share scales the exposure that was
    # measured.
    smears = sorted(watched.smears)
    smear = smears[int(SPEED_PERCENTILE * len(smears))]
    percent = math.ceil(100 * watched.blurred / watched.sightings)
    wanted_ms = _at_most_ms(smear.exposure_s * WANTED_SHARE / smear.share)
    return (
        f"{target}: blurred by {smear.smear_px:.1f} px at {smear.speed_mps:.1f} m/s, {smear.share:.0%} of its size,"
        f" with an exposure of {1e3 * smear.exposure_s:.3g} ms (in {percent} % of the frames): its distance is unsure"
        f' then. Write exposure = "{wanted_ms:g} ms" in [camera], with more light'
    )


def _at_most_ms(exposure_s: float) -> float:
    """Return an exposure in milliseconds, rounded down to two digits; 0.1 at least, which is a camera's step."""
    exposure_ms = 1e3 * exposure_s
    step_ms = 10.0 ** (math.floor(math.log10(exposure_ms)) - 1) if exposure_ms > 0 else 0.1
    return max(0.1, round(math.floor(exposure_ms / step_ms) * step_ms, 6))


# All targets of a run, in one frame after the other -------------------------------------------------------------------


class Perceiver:
    """Looks for the targets of one run, by name, and measures them. Names with one detector are of one kind.

    The lens, at any resolution of the frames' aspect, is scaled here, once for each resolution, and passed on:
    detectors and ranging must see the very same one.
    """

    def __init__(
        self,
        detectors: Mapping[str, Detector],
        camera_model: CameraModel,
        footings: Mapping[str, Footing] | None = None,
        second: SecondView | None = None,
    ) -> None:
        self.detectors = detectors
        self._footings = footings or {}
        self._second = second
        self._larger: dict[str, float] = {}  # of targets of unknown size, how much larger than assumed they are
        self._camera_model = camera_model
        self._lens = camera_model
        self._optics: Optics | None = None
        self._sightings: dict[str, LastOutline] = {}
        self._kinds = _kinds_of(detectors)
        self.expectations = prediction.Expectations()
        self.motion_blur = MotionBlur()

    def look(
        self, frame: Frame, tracks: Mapping[str, Track] | None = None, second: Frame | None = None
    ) -> tuple[tuple[Detection, ...], tuple[Measurement, ...]]:
        """Look for every target, with what tracks tell; return a detection and a measurement for each.

        Args:
            second: Of a run with a second camera, its frame that is nearest in time; None for none.

        Raises:
            CalibrationError: The frame has another aspect than the camera model, or the camera was set otherwise.
        """
        lens, at_s = self.lens_of(frame), frame.captured_at_s
        detections, measurements = [], []
        members: dict[str, Detection] = {}
        for kind in self._kinds:
            members |= kind.look(frame, lens, tracks or {})
        for name, detector in self.detectors.items():
            shape = detector.target_shape
            found = members.get(name)
            if found is None:
                expected = self.expectations.of(tracks.get(name), shape, lens, at_s) if tracks else None
                if expected is not None:
                    larger = expected.size_px * self._larger.get(name, 1.0)
                    expected = add_outline(replace(expected, size_px=larger), self._sightings.get(name), shape, lens)
                found = detector.detect(frame, expected, lens=lens)
            measured = self._measure(found, shape, frame, (tracks or {}).get(name), second)
            if shape.has_corners and measured.depth_m is not None:
                self._sightings[name] = LastOutline(found.outline_px, found.centre_px, measured.depth_m)
            self.motion_blur.add(frame, found, measured, lens.fx_px)
            detections.append(found)
            measurements.append(measured)
        return tuple(detections), tuple(measurements)

    def _measure(
        self, found: Detection, shape: TargetShape, frame: Frame, track: Track | None, second: Frame | None
    ) -> Measurement:
        """Measure a target by its size, and by a second camera or the floor."""
        lens = self._lens
        by_size = measured = measure(found, shape, lens, frame.captured_at_s)
        if self._second is not None:
            seen = SeenTarget(detection=found, measurement=by_size, shape=shape)
            measured = self._second.join(seen, track, frame, second)
        is_joined = measured.distance_m != by_size.distance_m
        if found.target in self._footings and not is_joined:
            measured = stand(measured, found, shape, lens, self._footings[found.target]).measurement
        return self._without_size(measured, by_size) if math.isinf(shape.relative_sigma) else measured

    def _without_size(self, measured: Measurement, by_size: Measurement) -> Measurement:
        """Return the measurement made without the size, and learn that; or that nothing was."""
        if measured.distance_m is None or not math.isfinite(measured.sigma_m or math.inf):
            return measured if measured.distance_m is None else unmeasured(measured)
        self._larger[measured.target] = measured.distance_m / (by_size.distance_m or math.inf)
        return measured

    def lens_of(self, frame: Frame) -> CameraModel:
        """Return the camera model for the frame, whose resolution, subsampling and optics hardly ever change."""
        lens = self._lens
        # Scaling a lens takes longer than this comparison, and detector and ranging must get the same object.
        is_same = (lens.width_px, lens.height_px) == (frame.width_px, frame.height_px) and frame.optics is self._optics
        if not is_same or lens.subsampling != (self._camera_model.subsampling or frame.subsampling):
            lens = self._lens = self._camera_model.for_frame(frame)
            self._optics = frame.optics
        return lens


def _kinds_of(detectors: Mapping[str, Detector]) -> tuple[Several, ...]:
    """Find the detectors of each kind of which there are several: the names with one and the same detector."""
    names: dict[int, list[str]] = {}
    for name, detector in detectors.items():
        names.setdefault(id(detector), []).append(name)
    several = ((detectors[members[0]], members) for members in names.values())
    return tuple(
        Several(members, detector)
        for detector, members in several
        if isinstance(detector, TracksSeveral) and (len(members) > 1 or detector.numbers)
    )


class LastOutline(NamedTuple):
    """The corners and the centre of a target when it was last seen, in pixels, and its depth then."""

    outline_px: Points
    centre_px: tuple[float, float]
    depth_m: float


def add_outline(
    expected: Prediction, sighting: LastOutline | None, shape: TargetShape, camera: CameraModel
) -> Prediction:
    """Return a prediction with the corners that were last seen, moved and scaled to where and how large it is."""
    if sighting is None:
        return expected
    # Apparent length then, in pixels by similar triangles; the ratio of both lengths scales the corners about the
    # centre, which is moved.
    then_px = shape.longest_m / sighting.depth_m * math.sqrt(camera.fx_px * camera.fy_px)
    around = sighting.outline_px - np.array(sighting.centre_px)
    outline_px = around * (expected.size_px / then_px) + np.array(expected.centre_px)
    return replace(expected, outline_px=outline_px)
