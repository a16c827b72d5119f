"""Whether outputs may act. Everything that affects this decision is in this file.

================  =====================================  ==========
mode              what happens                           next mode
================  =====================================  ==========
any               the newest frame is older than limit   stale (starting, before the first good frames)
starting, stale   enough fresh frames in a row           active
active            a fresh frame                          active
================  =====================================  ==========

In every mode but active, every output is kept at its safe value, whatever the rules ask for. An output whose driver
failed is kept at its safe value in every mode. This is not a certified safety function: below it must be a base with a
timeout of its own, a pull-down on each gate, and a switch in the motor supply.
"""

from __future__ import annotations

from dataclasses import dataclass

from stadimeter.core.decision import SafetyMode
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Safety

FROM_THE_FUTURE_S = 0.05
"""A frame may seem to be this much younger than now: clocks are read one after the other. More is a broken stamp."""


ROUNDING_S = 1e-6
"""An age of exactly the limit is within it, however its sum was rounded."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SafetyState:
    """What safety remembers.

    Attributes:
        mode: Whether outputs may act.
        good_frames: How many fresh frames came in a row.
        frame: The newest frame.
        reason: Why outputs may not act; empty if they may.
    """

    mode: SafetyMode = SafetyMode.STARTING
    good_frames: int = 0
    frame: FrameStamp | None = None
    reason: str = "no frame yet"


def step_safety(state: SafetyState, observation: Observation, settings: Safety) -> SafetyState:
    """Judge one cycle.

    Args:
        state: What safety remembers.
        observation: What is known in this cycle.
        settings: The limits.

    Returns:
        What it remembers now.
    """
    frame = _newest(state.frame, observation.frame, observation.now_s)
    is_new = frame is not state.frame
    fault = _fault(frame, observation, settings)
    if fault:
        mode = SafetyMode.STARTING if state.mode is SafetyMode.STARTING else SafetyMode.STALE
        return SafetyState(mode=mode, good_frames=0, frame=frame, reason=fault)
    good_frames = min(settings.good_frames, state.good_frames + is_new)
    if state.mode is SafetyMode.ACTIVE or good_frames >= settings.good_frames:
        return SafetyState(mode=SafetyMode.ACTIVE, good_frames=good_frames, frame=frame, reason="")
    reason = f"{good_frames} of {settings.good_frames} fresh frames in a row"
    return SafetyState(mode=state.mode, good_frames=good_frames, frame=frame, reason=reason)


def _newest(before: FrameStamp | None, new: FrameStamp | None, now_s: float) -> FrameStamp | None:
    """Return the newest frame that has a sound stamp.

    A frame is new only if its capture time moved on: a stuck driver repeats the old one. A stamp from the future, or
    one that is no number, is not believed: it would make every later frame look old.
    """
    if new is None or not new.captured_at_s <= now_s + FROM_THE_FUTURE_S:
        return before
    if before is not None and not new.captured_at_s > before.captured_at_s:
        return before
    return new


def _fault(frame: FrameStamp | None, observation: Observation, settings: Safety) -> str:
    """Return why the newest frame may not be acted on, or an empty string."""
    if frame is None:
        return observation.camera_fault or "no frame yet"
    age_s = observation.now_s - frame.captured_at_s
    if age_s <= settings.max_frame_age_s + ROUNDING_S:
        return ""
    words = f"the newest frame is {age_s * 1000:.0f} ms old, limit {settings.max_frame_age_s * 1000:.0f} ms"
    return f"{words}: {observation.camera_fault}" if observation.camera_fault else words
