"""Trying the rules before the setup is complete: on the camera's picture, and on a simulated target."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

import cv2
import numpy as np

from stadimeter.app.detectors import build_detectors
from stadimeter.config.loader import Configuration
from stadimeter.config.plugins import DriverChoice
from stadimeter.config.rule_test_tables import InputTable
from stadimeter.core.decide import decide, initial_state
from stadimeter.core.detection import Detection, DetectionStatus
from stadimeter.core.frame import Frame, Image
from stadimeter.core.measurement import Measurement
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from stadimeter.core.words import metres
from stadimeter.errors import ConfigError, PictureError, StadimeterError
from stadimeter.ranging.similar_triangles import expect, farthest_m
from stadimeter.workbench.annotation import Mark, annotate
from stadimeter.workbench.measuring import Measuring
from stadimeter.workbench.picture_metadata import picture_remarks
from stadimeter.workbench.replay.comparison import Lane, Point, thin_points
from stadimeter.workbench.rule_tests.inputs import observations, wait_times
from stadimeter.workbench.rule_tests.running import command_figures
from stadimeter.workbench.setup.files import blank_answers, figure_si, find_wishes, tag_name
from stadimeter.workbench.setup.question import Known
from stadimeter.workbench.setup.target import (
    WHOLE_SHARE,
    build_target,
    describe_detection,
    kind_of,
    kind_steps,
    members_of,
    target_shape,
)

# The rules are tried on this many seconds of the camera's past measurements.
LAST_S = 60.0

# With fewer seconds of them, a simulated target is used.
ENOUGH_S = 2.0

# The simulated target's times: to come or to go, to stand at both ends, and out of sight at the end, in seconds.
WALK_S, STAND_S, GONE_S = 6.0, 2.0, 3.0

MAX_DURATION_S = 700.0

# It goes from this far at the left to as far at the right, which the view of most cameras holds. On this date the sun
# rises and sets everywhere.
SIDE_DEG = 20.0
EQUINOX = "2026-03-21"

# Where nothing was seen for longer, time went on without frames.
GAP_S = 1.0


def recent_observations(history: Sequence[Measurement]) -> Iterator[Observation]:
    """Yield the camera's measurements of the last minute as observations of a run; none if they are too few."""
    since_s = history[-1].captured_at_s - LAST_S if history else 0.0
    lately = [each for each in history if each.captured_at_s >= since_s]
    if not lately or lately[-1].captured_at_s - lately[0].captured_at_s < ENOUGH_S:
        return
    before_s = lately[0].captured_at_s
    for number, measured in enumerate(lately):
        now_s = measured.captured_at_s
        if now_s - before_s > GAP_S:
            yield from (Observation(now_s=at_s, camera_fault="no frame") for at_s in wait_times(before_s, now_s))
        stamp = FrameStamp(sequence=number, captured_at_s=now_s)
        yield Observation(now_s=now_s, frame=stamp, measurements=(measured,))
        before_s = now_s


def simulate_approach(configuration: Configuration, answers: Mapping[str, str]) -> Iterator[Observation]:
    """Yield observations of a target that comes from beyond every distance of the wishes, goes back, and disappears.

    It does so as often as the wishes count, goes to the left and to the right where it is near, and passes
    a second target. It begins at the first time of day that they name, or else at midnight.
    """
    figures = _figures(answers)
    far_m, near_m = 1.5 * max(figures["m"], default=2.0), 0.6 * min(figures["m"], default=1.0)
    gone_s = min(MAX_DURATION_S, max(GONE_S, *(1.2 * each for each in figures["s"]), 0.0))
    visits = int(max(figures["times"], default=0.0)) + 1 if figures["times"] else 1
    points, at_s = [], 0.0
    for distance_m, stays_s in ((far_m, STAND_S), (near_m, max(STAND_S, WALK_S / 2)), (far_m, STAND_S)):
        # Where it is near, it goes to the left and then to the right.
        sides_deg = (0.0, -SIDE_DEG, SIDE_DEG, 0.0) if distance_m == near_m else (0.0, 0.0)
        steps = len(sides_deg) - 1
        points += [(at_s + stays_s * step / steps, distance_m, side_deg) for step, side_deg in enumerate(sides_deg)]
        at_s += stays_s + WALK_S
    once_s = points[-1][0]
    end_s = visits * once_s
    walks = [(number * once_s + moment_s, *place) for number in range(visits) for moment_s, *place in points]
    walks.append((end_s + gone_s, far_m, 0.0))
    moving = {
        "points": [
            {"at": f"{moment_s} s", "distance": f"{distance_m} m", "bearing": f"{bearing_deg} deg"}
            for moment_s, distance_m, bearing_deg in walks
        ],
        "lost": [{"from": f"{end_s} s", "for": f"{gone_s + 1} s"}],
    }
    # Where the target is near, it is nearer than the second one by what the wishes ask for.
    second_m = max((far_m + near_m) / 2, near_m + 1.3 * min(figures["m"], default=0.0))
    hovering = {"hover": {"at": f"{second_m} m", "for": f"{end_s + gone_s} s"}}
    others = {tag_name(tag): hovering for tag in blank_answers(answers, "tag").values()}
    table = {
        "targets": {**dict.fromkeys(members_of(answers), moving), **others},
        "rate": "10 Hz",
        "clock": next(iter(blank_answers(answers, "time").values()), "00:00"),
        "date": EQUINOX,
    }
    yield from observations(InputTable.model_validate(table), configuration)


def _figures(answers: Mapping[str, str]) -> Mapping[str, list[float]]:
    """Return the quantities of the wishes by their SI unit, and what they count by ``times``."""
    figures: defaultdict[str, list[float]] = defaultdict(list)
    for wish in find_wishes(answers):
        for blank in (blank for blank in wish.blanks if blank.kind in {"quantity", "count"}):
            with suppress(ConfigError):  # what the question refuses
                figures[blank.unit or "times"].append(figure_si(answers[f"{wish.key}_{blank.key}"], blank))
    return figures


# Distances that people think in, for each power of ten.
STEPS = (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0)

ROWS_MAX = 9


def outlook(known: Known) -> dict[str, Any]:
    """Return a table of distances with what to expect there, as JSON has it.

    Raises:
        ConfigError: The camera is not calibrated yet.
    """
    shape, lens = target_shape(build_target(known)), known.lens.for_frame(known.frame)
    nearest_m = farthest_m(shape, lens, WHOLE_SHARE * min(lens.width_px, lens.height_px))
    reaches_m = farthest_m(shape, lens)
    rows = [expect(shape, lens, each) for each in (nearest_m, *_between(nearest_m, reaches_m), reaches_m)]
    return {
        "nearest_m": nearest_m,
        "farthest_m": reaches_m,
        "focal_sigma_share": lens.focal_relative_sigma,
        "rows": [
            {"distance_m": each.distance_m, "sigma_m": each.sigma_m, "noise_m": each.noise_m, "width_px": each.size_px}
            for each in rows
        ],
    }


def _between(low_m: float, high_m: float) -> list[float]:
    """Return distances that people think in between two, not too many."""
    first, last = math.floor(math.log10(low_m)), math.ceil(math.log10(high_m))
    every = sorted({step * 10.0**power for power in range(first, last + 1) for step in STEPS})
    within = [each for each in every if 1.1 * low_m < each < high_m / 1.1]
    return within[:: 1 + len(within) // ROWS_MAX]


JPEG_QUALITY = 80

DRAWINGS = ("plain", "target", "mask", "candidates")


def target_so_far(known: Known, colour: str = "") -> DriverChoice | None:
    """Return the target as far as the answers tell it; None before it can be looked for.

    Args:
        colour: A range that is tried; empty for that of the answers.
    """
    answers = known.answers
    if "target" not in answers or any(step.key not in answers for step in kind_steps(answers)):
        return None
    if kind_of(answers).has_colour and not (colour or "colour" in answers):
        return None
    try:
        return build_target(known, **({"colour": colour} if colour else {}))
    except StadimeterError:
        return None


def look_for_target(known: Known, frame: Frame, target: DriverChoice) -> tuple[Detection, Measurement | None]:
    """Look for the target in a frame, and measure it if the lens is known already."""
    (named,) = build_detectors([target], known.camera_model)
    if known.camera_model is None:
        return named.detector.detect(frame), None
    result = Measuring([named], known.camera_model).measure(frame, "").targets[0]
    return result.detection or Detection(target=target.name, status=DetectionStatus.NOT_FOUND), result.measurement


def describe_picture(frame: Frame, seen: Detection | None, measured: Measurement | None) -> Mapping[str, Any]:
    """Describe what is known of a picture, as JSON has it; places are in the camera's own pixels."""
    remarks = [f"{each[0].upper()}{each[1:]}." for each in picture_remarks(frame.image, frame.exposure_s)]
    found = seen if seen is not None and seen.is_whole else None
    return {
        "width_px": frame.width_px,
        "height_px": frame.height_px,
        "exposure_s": frame.exposure_s,
        "remarks": remarks,
        "words": describe_detection(seen.target, seen) if seen else "",
        "status": seen.status.value if seen else None,
        "found": found is not None,
        "distance_m": measured.distance_m if measured else None,
        "sigma_m": measured.sigma_m if measured else None,
        "centre_px": [round(each, 1) for each in found.centre_px] if found else None,
        "size_px": [round(found.width_px, 1), round(found.height_px, 1)] if found else None,
        "rejected": [
            {"centre_px": list(each.centre_px), "size_px": each.size_px, "reason": each.reason}
            for each in (seen.rejected if seen else ())
        ],
    }


def draw_findings(frame: Frame, seen: Detection, measured: Measurement | None, *, with_candidates: bool) -> Image:
    """Return the picture with the target's outline, and the numbered candidates that were refused."""
    headline = seen.target
    if measured is not None and measured.distance_m is not None:
        headline = f"{headline}: {metres(measured.distance_m, measured.sigma_m or 0.0)}"
    mark = Mark(
        detection=seen,
        has_corners=len(seen.outline_px) == 4,
        headline=headline,
        rejected=tuple(enumerate(seen.rejected, start=1)) if with_candidates else (),
    )
    return annotate(frame.image, [mark])


def encode_jpeg(image: Image, width_px: int = 0) -> bytes:
    """Return a picture as JPEG, no wider than asked for; 0 for as it is."""
    if 0 < width_px < image.shape[1]:
        height_px = max(1, round(image.shape[0] * width_px / image.shape[1]))
        image = np.asarray(cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_AREA), np.uint8)
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise PictureError("the picture cannot be encoded")
    return data.tobytes()


# The number of events that are listed beside a chart.
EVENTS_MAX = 100


def show_decisions(plan: Plan, seen: Iterable[Observation]) -> dict[str, Any]:
    """Decide on observations by a plan, and return what came of it as JSON has it; opens and moves nothing.

    Times are in seconds from the first observation. ``rules`` says when each was active; ``outputs`` from when on each
    had which level, or which speeds forwards and of turning.
    """
    active: defaultdict[str, Lane] = defaultdict(Lane)
    steps: defaultdict[str, list[tuple[float, ...]]] = defaultdict(list)
    samples: defaultdict[str, list[Point]] = defaultdict(list)
    events: list[dict[str, Any]] = []
    state, start_s, at_s = initial_state(plan), None, 0.0
    for observation in seen:
        state, decision = decide(state, observation)
        start_s = observation.now_s if start_s is None else start_s
        at_s = observation.now_s - start_s
        for trace in decision.rules:
            active[trace.rule].add(at_s, is_on=trace.active is True)
        for command in decision.commands:
            figures, before = command_figures(command), steps[command.output]
            if not before or before[-1][1:] != figures:
                before.append((at_s, *figures))
        for measured in observation.measurements:
            samples[measured.target].append((at_s, measured.distance_m, measured.sigma_m or 0.0))
        events += [
            {"at_s": at_s, "kind": event.kind.value, "source": event.source, "reason": event.reason}
            for event in decision.events
        ]
    return {
        "seconds": at_s,
        "rules": [
            {"rule": rule, "active": [{"from_s": start, "to_s": end} for start, end in lane.spans]}
            for rule, lane in active.items()
        ],
        "outputs": [{"output": name, "steps": [list(step) for step in each]} for name, each in steps.items()],
        "samples": {name: list(map(list, thin_points(points))) for name, points in samples.items()},
        "events": events[:EVENTS_MAX],
    }
