"""Liveness by motion: a camera that rides on the base must see that it moves.

A picture can be new in every frame and show nothing of what is: a clock that runs over a frozen sensor, a frozen
picture with noise. What no such picture can show is the robot's own motion. So while the wheels turn, the blocks of
the picture must flow (`PictureFlow`), by as much as the way and the turn since the earlier picture make at least.

The flow that is expected at least, in pixels, is that of a turn, or of a drive towards walls `ROOM_DEPTH_M` away:
``f · Δψ`` or ``x · Δs / Z``. The picture stands still, for one frame, if the measured flow is below `STILL_SHARE` of
this. How sure that is, in standard deviations, is added up over the frames (E. S. Page, "Continuous inspection
schemes", 1954); a frame that flows takes off as much. Below `MIN_FLOW_PX` nothing is claimed. In rooms too plain for
this, the target is the second line: see `target_innovation`.

With a picture that is found to stand still, everything stops until the run is armed again: the camera is frozen, or the
robot pushes against something while its wheels slip; neither is a reason to drive on.
"""

from __future__ import annotations

from collections.abc import Mapping

from msgspec import Struct, field
from msgspec.structs import replace

from stadimeter.core.command import TwistCommand
from stadimeter.core.decision import Event, EventKind, Severity
from stadimeter.core.ego_motion import EgoMotion
from stadimeter.core.measurement import Measurement
from stadimeter.core.observation import Observation
from stadimeter.core.picture_flow import FlowSince, PictureFlow
from stadimeter.core.target_innovation import FALSE_ALARM, TargetInnovation, step_innovation

# What is seen in a room is this far away at most, as a median over the picture. In larger halls, and out of doors,
# liveness cannot be judged by driving straight on.
ROOM_DEPTH_M = 5.0

# A flow below this, in pixels of a picture reduced to 160, does not differ from none: 3 cm of driving, 0.1° of turning.
MIN_FLOW_PX = 0.2

# Larger shifts are measured too small, but never as less than about a pixel.
MAX_FLOW_PX = 1.0

# A picture stands still if it flows by less than this share of what is expected: depths differ, motors are slow.
STILL_SHARE = 0.4

# A look that could not tell standing from flowing by this many standard deviations says nothing.
MIN_SIGMAS = 2.0

# A look counts while the view turns by no more than this from one picture to the next: textures of two pixels and more
# are still the same then.
MAX_STEP_PX = 3.0

# One frame counts for no more than this many standard deviations, less the drift; the sum that stops the robot is that
# of two clear frames, or of more that are less clear.
MAX_SCORE = 3.0
DRIFT = 0.5
STOP_SCORE = 5.0

# With less texture, as a share of the picture's blocks, a room is too plain to tell.
MIN_TEXTURED = 0.15


class LivenessState(Struct, frozen=True, kw_only=True):
    """What liveness remembers.

    Attributes:
        ego: How the robot has moved.
        score: How sure it is that the picture stands still although the wheels turn, 0 and more.
        targets: How each target appeared, against the robot's motion.
        may_act: Whether outputs might act in the cycle before.
    """

    ego: EgoMotion = EgoMotion()
    score: float = 0.0
    targets: Mapping[str, TargetInnovation] = field(default_factory=dict)
    may_act: bool = False


def step_liveness(
    state: LivenessState, observation: Observation, command: TwistCommand | None, *, is_new: bool
) -> tuple[LivenessState, str]:
    """Judge one cycle; return also why the picture is not believed, in words, or an empty string.

    Args:
        command: What the base was commanded to do in the cycle before; None without a base.
        is_new: Whether the frame is a new one, with a sound stamp.
    """
    if command is None:
        return state, ""
    state = replace(state, ego=state.ego.step(observation.now_s, command, observation.base))
    if not is_new or observation.flow is None or observation.frame is None:
        return state, ""
    score, still = _step_score(state, observation.flow, observation.frame.captured_at_s)
    # Range sensors measure at times of their own, and show what stands before the robot wherever it turns.
    at_s = observation.frame.captured_at_s
    of_camera = tuple([seen for seen in observation.measurements if seen.captured_at_s == at_s])
    targets, unmoved = _step_targets(state, of_camera)
    # What was found is found anew after the run is armed again, and not from what was before.
    cause = still or unmoved
    return replace(state, score=0.0 if cause else score, targets={} if cause else targets), cause


def _step_score(state: LivenessState, picture: PictureFlow, at_s: float) -> tuple[float, str]:
    """Judge the youngest look that can tell; return the score, and why the picture is not believed."""
    for flow in picture.since:
        travel_m, turn_rad = state.ego.least_since(flow.since_s, at_s)
        if (sigmas := _still_sigmas(flow, travel_m, turn_rad, at_s)) is None:
            continue
        score = max(0.0, state.score + max(-MAX_SCORE, min(MAX_SCORE, sigmas)) - DRIFT)
        way = f"{1e2 * travel_m:.0f} cm and {turn_rad:.2f} rad in {at_s - flow.since_s:.2f} s"
        cause = f"the picture stands still while the wheels turn ({way}): it is frozen, or the wheels slip"
        return score, cause if score >= STOP_SCORE else ""
    return state.score, ""


def _step_targets(
    state: LivenessState, measurements: tuple[Measurement, ...]
) -> tuple[Mapping[str, TargetInnovation], str]:
    """Take in what was measured; return also which target is not where the robot's motion must make it appear."""
    targets = dict(state.targets)
    for seen in measurements:
        innovation = step_innovation(targets.get(seen.target), seen, state.ego)
        if innovation is not None:
            targets[seen.target] = innovation
            if innovation.false_alarm <= FALSE_ALARM:
                return (
                    targets,
                    f"'{seen.target}' stays in its place in the picture, however the robot turns: it is frozen",
                )
    return targets, ""


def _still_sigmas(flow: FlowSince, travel_m: float, turn_rad: float, at_s: float) -> float | None:
    """Return how sure it is that a picture stands still, in standard deviations; below 0 if it flows.

    None if this look does not say so: too little motion, too much noise, too fast a turn.
    """
    expected_px = max(flow.focal_px * turn_rad, flow.aside_px * travel_m / ROOM_DEPTH_M)
    step_px = flow.focal_px * turn_rad * flow.step_s / max(at_s - flow.since_s, flow.step_s)
    if expected_px < MIN_FLOW_PX or step_px > MAX_STEP_PX:
        return None
    still_px2 = (STILL_SHARE * min(expected_px, MAX_FLOW_PX)) ** 2
    # Pictures that are equal to the last bit scatter by nothing at all.
    sigma_px2 = max(flow.sigma_px2, 1e-6)
    is_clear = still_px2 >= MIN_SIGMAS * sigma_px2 or flow.shift2_px2 >= still_px2
    return (still_px2 - flow.shift2_px2) / sigma_px2 if is_clear else None


def tell_plain_room(
    state: LivenessState, observation: Observation, *, may_act: bool
) -> tuple[LivenessState, tuple[Event, ...]]:
    """Return an event if outputs may act from now on, and the room is too plain to tell a frozen picture.

    Args:
        may_act: Whether outputs may act in this cycle.
    """
    flow = observation.flow
    if flow is None or may_act is state.may_act:
        return state, ()
    state = replace(state, may_act=may_act)
    if not may_act or flow.textured >= MIN_TEXTURED:
        return state, ()
    reason = (
        f"only {100 * flow.textured:.0f} % of the picture has texture, {100 * MIN_TEXTURED:.0f} % are needed: here a "
        "frozen picture looks like a live one, also while the robot drives"
    )
    event = Event(
        kind=EventKind.LIVENESS_UNKNOWN,
        source="camera",
        at_s=observation.now_s,
        severity=Severity.WARNING,
        reason=reason,
    )
    return state, (event,)
