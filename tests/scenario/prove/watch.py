"""What must hold in every trial, judged by the faults that were staged and by the emulated wheels alone.

The program under proof is not asked whether it is safe. From the faults follows until when wheels may turn:

=========  ==============================================================================================
reason     wheels stand within
=========  ==============================================================================================
frames     the lease, or ``max_frame_age`` if longer, after the newest sound frame was taken
target     ``coast`` of the tracking and ``max_frame_age`` after the newest that showed it; but a search may turn
end        at once after the run was ended or lost its watchdog process, or after a defect
sensors    the lease after a sensor with ``stop_below`` fell silent
program    the watchdog process has acted, or the base's own time-out, if the process was stopped or killed
cable      the base's own time-out after the base was last able to hear
=========  ==============================================================================================

To each comes `REACTION_S`; from then on they must slow down as emulated wheels do. When a base hears again that was
only deaf, the stop must be repeated within `REPEATED_WITHIN_S`. And in every cycle a command that moves the base needs
safety that is active, enough sound frames in a row since the last gap, a base that was plugged in for `REST_S`, and
speeds within the limits of the configuration.

Of a base that only turns a camera the servos are watched in place of wheels: their rates in rad/s, averaged over a
tenth of a second, since a servo goes in steps from pulse to pulse. During a search it may pan, and not tilt.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator

from msgspec import Struct, field

from stadimeter.app.cycle import CycleRecord
from stadimeter.app.guard import REST_S
from stadimeter.core.command import TwistCommand
from stadimeter.core.decision import SafetyMode
from stadimeter.core.rule import ROUNDING_S

# The guard looks every 20 ms, the emulated port is served every 10 ms, and the wheels are looked at every 10 ms;
# a cycle that waits for a frame ends 1 ms after the newest one is too old.
REACTION_S = 0.06

# Emulated wheels follow their motors with a time constant of 0.1 s; those of motors that coast, of 0.15 s.
RUN_OUT_S = 0.16
STANDING_SHARE = 0.05

# Drivers repeat a stop every 0.1 s, and every 0.2 s while they greet a base.
REPEATED_WITHIN_S = 0.25

# A base that never stops by itself must not be left alone for longer than the firmware time-out that we ask for.
WITHOUT_TIME_OUT_S = 0.5

# Wheels may be this much faster than commanded: commands are rounded to whole encoder ticks.
SPEED_TOLERANCE = 1.1

# After this long a wheel has forgotten the command before: seven times the time constant of wheels that coast.
FORGOTTEN_S = 1.0

# A gap between frames is asked to be noticed if it is this much longer than the age that is allowed.
GAP_MARGIN_S = 0.1


class MotionLimits(Struct, frozen=True, kw_only=True):
    """What the configuration allows.

    Attributes:
        stale_s: For how long a frame justifies motion.
        lost_s: For how long after the target was last seen the base may move.
        beyond_s: After this long without a command the base stops by itself; infinite for never.
        parts: What is watched: ``wheels``, whose speeds are in m/s, or ``servos``, whose rates are in rad/s.
        fastest: Largest speed of one of them.
        half_track_m: Half the distance between the wheels; None for a base without.
        cruise: How fast the rule moves them at most.
        gap_s: Frames further apart than this are not in a row.
        good_frames: How many frames in a row are needed before anything moves.
        searches: Whether the base turns on the spot to find a target that it lost.
        watches_near: Whether a range sensor that falls silent must stop the base.
        needs_arming: Whether the run must be armed again before anything moves after the base was out of order.
    """

    stale_s: float
    lost_s: float
    beyond_s: float
    parts: str
    fastest: float
    half_track_m: float | None
    cruise: float
    linear_mps: float
    angular_radps: float
    gap_s: float
    good_frames: int
    searches: bool
    watches_near: bool
    needs_arming: bool

    @property
    def unit(self) -> str:
        """Of the speeds that are watched."""
        return "m/s" if self.parts == "wheels" else "rad/s"


# From when on wheels must stand, since when that counts, and by which reason.
_Due = tuple[float, float, str]


class Violation(Struct, frozen=True, kw_only=True):
    """What did not hold, and when."""

    at_s: float
    words: str


class MotionWatch(Struct):
    """Judges one trial.

    Attributes:
        violation: The first thing that did not hold.
        longest_s: By reason, for how long the wheels turned at most after it began.
        driven: The fastest that a wheel or a servo turned.
        moved_since_s: Since when every cycle has moved the base; infinite if the last one did not.
        turned_s: When the wheels last turned.
    """

    limits: MotionLimits
    violation: Violation | None = None
    longest_s: dict[str, float] = field(default_factory=dict)
    driven: float = 0.0
    moved_since_s: float = math.inf
    turned_s: float = -math.inf
    _fresh_s: float = -math.inf
    _seen_s: float = -math.inf
    _frames: int = 0
    _ended_s: float = math.inf
    _silent_s: float = math.inf
    _is_noisy: bool = False
    _deaf_s: float | None = None
    _stopped_s: float | None = None
    _safe_by_s: float = math.inf
    _left_s: float | None = None
    _hears_s: float = -math.inf
    _unplugged_s: float = -math.inf
    _plugged_s: float = -math.inf
    _commanded: deque[tuple[float, tuple[float, float]]] = field(default_factory=deque)

    def note_fresh_frame(self, taken_s: float, looked_s: float, *, shows_target: bool) -> None:
        """Take in that the loop has looked at a new picture with a sound stamp, and when it began to."""
        is_in_time = looked_s - taken_s <= self.limits.gap_s
        is_next = taken_s - self._fresh_s <= self.limits.gap_s + GAP_MARGIN_S
        self._frames = (self._frames + 1 if is_next else 1) if is_in_time else 0
        self._fresh_s = max(self._fresh_s, taken_s)
        if shows_target:
            self._seen_s = max(self._seen_s, taken_s)

    def note_end(self, now_s: float) -> None:
        """Take in that nothing may move any more."""
        self._ended_s = min(self._ended_s, now_s)
        self.note_stop_lost(now_s)

    def note_sensors(self, now_s: float, *, is_silent: bool) -> None:
        """Take in whether the sensors that watch over the base are silent now."""
        self._silent_s = min(self._silent_s, now_s) if is_silent else math.inf

    def note_cable(self, now_s: float, *, is_cut: bool, is_out: bool, is_noisy: bool) -> None:
        """Take in whether the base hears nothing now, whether its cable is out, and whether it may hear it wrong."""
        if self._is_noisy and not is_noisy:
            self._hears_s = now_s
        self._is_noisy = is_noisy
        if is_cut and self._deaf_s is None:
            self._deaf_s = now_s
        elif not is_cut and self._deaf_s is not None:
            self._deaf_s, self._hears_s = None, now_s
        if self._ended_s < math.inf:
            self.note_stop_lost(self._ended_s)
        if is_out:
            self._unplugged_s = now_s if self._plugged_s != math.inf else self._unplugged_s
            self._plugged_s = math.inf
        elif self._plugged_s == math.inf:
            self._plugged_s = now_s

    def note_stop_lost(self, sent_s: float) -> None:
        """Take in when the last stop is sent: a base that does not hear it is left alone, for nothing repeats it."""
        if self._deaf_s is not None or self._is_noisy:
            self._left_s = sent_s if self._deaf_s is None else self._deaf_s

    def note_program(self, now_s: float, safe_by_s: float | None) -> None:
        """Take in that the process is stopped or killed now, and by when others make the base safe; None: it goes on.

        Args:
            safe_by_s: Infinite where nothing but the base itself does.
        """
        if safe_by_s is None:
            self._stopped_s, self._hears_s = None, now_s
        else:
            self._stopped_s = now_s if self._stopped_s is None else self._stopped_s
            self._safe_by_s = safe_by_s

    def see(self, now_s: float, speeds: tuple[float, float]) -> None:
        """Judge how the left and the right wheel turn now, or the servos that turn and tilt a camera."""
        fastest, limit, unit = max(map(abs, speeds)), self.limits.fastest, self.limits.unit
        self.driven = max(self.driven, fastest)
        if fastest > limit * SPEED_TOLERANCE:
            part = self.limits.parts.removesuffix("s")
            self._violate(now_s, f"a {part} turns at {fastest:.2f} {unit}, limit {limit:.2f} {unit}")
        self._judge_commanded(now_s, speeds)
        if fastest > STANDING_SHARE * limit:
            self.turned_s = now_s
        frames = (self._fresh_s + self.limits.stale_s, self._fresh_s, "frames")
        target = (self._seen_s + self.limits.lost_s, self._seen_s, "target")
        sensors = (self._silent_s + self.limits.stale_s, self._silent_s, "sensors")
        end = min((self._ended_s, self._ended_s, "end"), sensors)
        if self.limits.searches:  # without its target the base may turn on the spot, as long as it sees
            self._judge(now_s, fastest, min(frames, end))
            self._judge(now_s, abs(sum(speeds)) / 2 if self.limits.parts == "wheels" else abs(speeds[1]), target)
        else:
            self._judge(now_s, fastest, min(frames, target, end))

    def _judge_commanded(self, now_s: float, speeds: tuple[float, float]) -> None:
        """Judge which way each wheel turns and how fast: between standing and what it was commanded lately.

        A base that may not have heard every command as it was sent goes by others.
        """
        while len(self._commanded) > 1 and self._commanded[0][0] < now_s - FORGOTTEN_S:
            self._commanded.popleft()
        heard_s = max(self._hears_s, self._unplugged_s) + FORGOTTEN_S
        if self.limits.half_track_m is None or self._is_noisy or self._deaf_s is not None or now_s < heard_s:
            return
        slack_mps = STANDING_SHARE * self.limits.fastest
        for wheel, speed_mps in enumerate(speeds):
            commanded = [0.0, *(each[wheel] for _, each in self._commanded)]
            low_mps, high_mps = min(commanded), max(commanded)
            if not low_mps * SPEED_TOLERANCE - slack_mps <= speed_mps <= high_mps * SPEED_TOLERANCE + slack_mps:
                between = f"commanded were {low_mps:.2f} to {high_mps:.2f} m/s"
                self._violate(now_s, f"the {('left', 'right')[wheel]} wheel turns at {speed_mps:.2f} m/s, {between}")

    def _judge(self, now_s: float, speed: float, due: _Due) -> None:
        """Judge a speed by a reason to stand: from when on wheels must stand for it, and since when that counts."""
        if speed <= STANDING_SHARE * self.limits.fastest:
            return
        until_s, since_s, reason = self._when_slow(now_s, due)
        if math.isfinite(since_s):
            self.longest_s[reason] = max(self.longest_s.get(reason, 0.0), now_s - since_s)
        if now_s > until_s and speed > self.limits.fastest * math.exp((until_s - now_s) / RUN_OUT_S):
            self._violate(
                now_s,
                f"the {self.limits.parts} still turn at {speed:.2f} {self.limits.unit}, {now_s - since_s:.2f} s after "
                f"{SINCE[reason]}; they must slow down from {until_s - since_s:.2f} s on",
            )

    def _when_slow(self, now_s: float, due: _Due) -> _Due:
        """Return from when on the wheels must slow down, since when that counts, and by which reason."""
        # A stop that is due arrives only at a base that hears, from a program that runs: else the base is on its own.
        # It is, too, from when its cable is out until its driver has opened the port again and let it rest, and after
        # the end of a run of which it did not hear.
        alone = [
            (self._stopped_s, self._safe_by_s, "program"),
            (self._deaf_s, math.inf, "cable"),
            (self._left_s, math.inf, "cable"),
        ]
        if now_s < self._plugged_s + REST_S:
            alone.append((self._unplugged_s, math.inf, "cable"))
        own = [(self._alone_until_s(each, by_s), each, reason) for each, by_s, reason in alone if each is not None]
        due_s = self._alone_until_s(due[0], math.inf) if self._is_noisy else due[0]
        until_s, since_s, reason = max(own) if own else (max(due_s, self._hears_s + REPEATED_WITHIN_S), *due[1:])
        return until_s + REACTION_S, since_s, reason

    def _alone_until_s(self, since_s: float, safe_by_s: float) -> float:
        until_s = min(since_s + self.limits.beyond_s, safe_by_s)
        return until_s if until_s < math.inf else since_s + WITHOUT_TIME_OUT_S

    def see_cycle(self, record: CycleRecord) -> None:
        """Judge the commands of a cycle."""
        now_s = record.observation.now_s
        for each in record.applied:
            if isinstance(each, TwistCommand) and self.limits.half_track_m is not None:
                offset_mps = each.angular_radps * self.limits.half_track_m
                self._commanded.append((now_s, (each.linear_mps - offset_mps, each.linear_mps + offset_mps)))
        moved = [each for each in record.applied if isinstance(each, TwistCommand) and each.moves]
        if not moved:
            self.moved_since_s = math.inf
            return
        self.moved_since_s = min(self.moved_since_s, now_s)
        for words in self._why_not_to_move(now_s, record.decision.safety, moved[0]):
            self._violate(now_s, f"the base is moved {words}")

    def _why_not_to_move(self, now_s: float, safety: SafetyMode, twist: TwistCommand) -> Iterator[str]:
        limits, age_s = self.limits, now_s - self._fresh_s
        if safety is not SafetyMode.ACTIVE:
            yield f"while safety is {safety.value}"
        if age_s > limits.gap_s + ROUNDING_S:
            yield f"{age_s:.2f} s after the last sound frame was taken"
        if self._frames < limits.good_frames:
            yield f"after {self._frames} sound frames in a row, of {limits.good_frames}"
        if self._unplugged_s + REACTION_S < now_s < self._plugged_s + REST_S:
            yield f"before it has rested for {REST_S:g} s since its cable was out"
        if limits.needs_arming and -math.inf < self._unplugged_s < now_s - REACTION_S:
            yield "without being armed again since its cable was out"
        if now_s > self._ended_s:
            yield "after the end of the run"
        is_fast = abs(twist.linear_mps) > limits.linear_mps * SPEED_TOLERANCE
        turn_radps = max(twist.angular_radps, twist.tilt_radps, key=abs)
        if is_fast or abs(turn_radps) > limits.angular_radps * SPEED_TOLERANCE:
            yield (
                f"at {twist.linear_mps:.2f} m/s and {turn_radps:.2f} rad/s, "
                f"limits {limits.linear_mps:.2f} m/s and {limits.angular_radps:.2f} rad/s"
            )

    def _violate(self, at_s: float, words: str) -> None:
        self.violation = self.violation or Violation(at_s=at_s, words=words)


# Then the base is on its own.
BEYOND = frozenset({"program", "cable"})

SINCE = {
    "frames": "the last sound frame was taken",
    "target": "the target was last seen",
    "end": "the run was ended, or lost its watchdog process",
    "sensors": "the range sensors fell silent",
    "program": "the process was stopped",
    "cable": "the base last heard anything",
}
