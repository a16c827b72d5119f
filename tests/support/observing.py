"""Observations for tests of rules: a few words in, a whole observation out."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from stadimeter.core.decide import State, decide, initial_state
from stadimeter.core.decision import Decision
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.observation import FrameStamp, Observation
from stadimeter.core.plan import Plan
from stadimeter.operator_actions import OperatorAction, OperatorAnswer, OperatorCommand


def measured(
    target: str, at_s: float, distance_m: float, sigma_m: float = 0.01, bearing_rad: float = 0.0
) -> Measurement:
    """Return a measurement of a target straight ahead, or at a bearing.

    Args:
        sigma_m: The standard deviation, all of it noise.
        bearing_rad: Positive to the right.
    """
    return Measurement(
        target=target,
        status=MeasurementStatus.MEASURED,
        captured_at_s=at_s,
        distance_m=distance_m,
        depth_m=distance_m,
        sigma_m=sigma_m,
        noise_m=sigma_m,
        bearing_rad=bearing_rad,
        elevation_rad=0.0,
    )


def missed(target: str, at_s: float, reason: str = "no blob") -> Measurement:
    """Return the measurement of a target that is not in the picture."""
    return Measurement(target=target, status=MeasurementStatus.NOT_FOUND, captured_at_s=at_s, reason=reason)


class Rehearsal:
    """Runs a plan on distances that a test gives, a frame at a time.

    Args:
        frame_s: Time from frame to frame.

    Attributes:
        decisions: Every decision so far, with its time.
    """

    def __init__(self, plan: Plan, frame_s: float = 0.1) -> None:
        self.state: State = initial_state(plan)
        self.decisions: list[tuple[float, Decision]] = []
        self.now_s = 0.0
        self._frame_s = frame_s
        self._frames = 0

    def see(self, *distances_m: float | None, sigma_m: float = 0.01, bearing_rad: float = 0.0) -> Decision:
        """Give one frame for each distance; None is a frame without the target."""
        for distance_m in distances_m:
            at_s = self.now_s = round(self.now_s + self._frame_s, 9)
            (target,) = self.state.plan.targets
            seen = (
                missed(target, at_s) if distance_m is None else measured(target, at_s, distance_m, sigma_m, bearing_rad)
            )
            self.cycle(
                Observation(
                    now_s=at_s, frame=FrameStamp(sequence=self._frames, captured_at_s=at_s), measurements=(seen,)
                )
            )
            self._frames += 1
        return self.decisions[-1][1]

    def wait(self, seconds: float, camera_fault: str = "no frame in time") -> Decision:
        """Let time pass without a new frame, a cycle every tenth of a second."""
        until_s = self.now_s + seconds
        while self.now_s < until_s - 1e-9:
            self.now_s = round(self.now_s + 0.1, 9)
            self.cycle(Observation(now_s=self.now_s, camera_fault=camera_fault))
        return self.decisions[-1][1]

    def tell(
        self, action: str, rule: str = "", by: str = "Ada", why: str = "", *, for_s: float | None = None, **how: Any
    ) -> OperatorAnswer:
        """Tell a rule something, in a cycle of its own without a new frame."""
        self.now_s = round(self.now_s + 0.001, 9)
        command = OperatorCommand(
            id=str(len(self.decisions)), action=OperatorAction(action), rule=rule, by=by, why=why, for_s=for_s, **how
        )
        (answer,) = self.cycle(Observation(now_s=self.now_s, operator_commands=(command,))).answers
        return answer

    def cycle(self, observation: Observation) -> Decision:
        """Give any observation."""
        self.state, decision = decide(self.state, observation)
        self.decisions.append((observation.now_s, decision))
        return decision

    def events(self, source: str | None = None) -> list[str]:
        """Return the kinds of the events so far, in order.

        Args:
            source: Only those of this rule, target or output.
        """
        happened: Iterable[Decision] = (decision for _, decision in self.decisions)
        return [
            event.kind.value for decision in happened for event in decision.events if source in {None, event.source}
        ]
