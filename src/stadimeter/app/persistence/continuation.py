"""The state of a run in mid-course, as text: a recording that begins then replays to the same decisions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from pydantic import ConfigDict, TypeAdapter, ValidationError

from stadimeter.core.alarms.alarm import AlarmStep
from stadimeter.core.decide import State
from stadimeter.core.decision import Event
from stadimeter.core.holding import Hold
from stadimeter.core.observation import OutputFault
from stadimeter.core.outputs import OutputStep
from stadimeter.core.persistence import meaning_of
from stadimeter.core.rule import AnyRule
from stadimeter.core.rules.follow import FollowStep
from stadimeter.core.rules.ramp import RampStep
from stadimeter.core.rules.scheduler import RuleStep, with_steps
from stadimeter.core.safety import SafetyState
from stadimeter.core.tracking.life_cycle import TrackState
from stadimeter.errors import StateError

BEGINS = '[{"continued":'
"""How such a text begins. What a run restores from an earlier one begins otherwise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _RuleMemory:
    """What a rule remembers. By `meaning` it is known whether a rule of that name is still the same."""

    rule: str
    meaning: str
    alarm: AlarmStep | None = None
    ramp: RampStep | None = None
    follow: FollowStep | None = None

    @classmethod
    def of(cls, rule: AnyRule, step: RuleStep) -> _RuleMemory:
        """Return what a rule remembers."""
        memory = cls(rule=rule.name, meaning=meaning_of(rule))
        match step:
            case AlarmStep():
                return replace(memory, alarm=step)
            case RampStep():
                return replace(memory, ramp=step)
            case _:
                return replace(memory, follow=step)

    def step(self, rule: AnyRule) -> RuleStep | None:
        """Return it for a rule that means the same; None for any other."""
        return (self.alarm or self.ramp or self.follow) if self.meaning == meaning_of(rule) else None


@dataclass(frozen=True, slots=True, kw_only=True)
class _Course:
    """All that is remembered from one cycle to the next, without the plan."""

    now_s: float | None
    usual_step_s: float
    tracks: tuple[TrackState, ...]
    rules: tuple[_RuleMemory, ...]
    first_out: Mapping[str, str]
    safety: SafetyState
    outputs: tuple[OutputStep, ...]
    faults: tuple[OutputFault, ...]
    events: int
    due: tuple[Event, ...]
    holds: tuple[Hold, ...]
    stopped: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Continuation:
    """What a recording restores that was begun in mid-course."""

    continued: _Course

    def of(self, state: State) -> State:
        """Return the state with which to go on. What the plan has otherwise by now begins anew."""
        was, plan = self.continued, state.plan
        known = {memory.rule: memory for memory in was.rules}
        steps = tuple(
            (known[rule.name].step(rule) or new) if rule.name in known else new
            for rule, new in zip(plan.rules, state.rules.steps, strict=True)
        )
        tracks = {tracked.track.target: tracked for tracked in was.tracks}
        outputs = {step.command.output: step for step in was.outputs}
        names = {rule.name for rule in plan.rules}
        return replace(
            state,
            now_s=was.now_s,
            usual_step_s=was.usual_step_s,
            tracks=tuple(tracks.get(new.track.target, new) for new in state.tracks),
            rules=with_steps(plan, steps, {group: name for group, name in was.first_out.items() if name in names}),
            safety=was.safety,
            outputs=tuple(_like(outputs.get(new.command.output), new) for new in state.outputs),
            faults=was.faults,
            events=was.events,
            due=was.due,
            holds=was.holds,
            stopped=was.stopped,
        )


def _like(was: OutputStep | None, new: OutputStep) -> OutputStep:
    return was if was is not None and type(was.command) is type(new.command) else new


_ONE: TypeAdapter[tuple[Continuation]] = TypeAdapter(
    tuple[Continuation], config=ConfigDict(ser_json_inf_nan="constants")
)
"""A configuration can be given for a tuple, and not for a dataclass."""


def continuation_text(state: State) -> str:
    """Return the state of a run as text, for a recording."""
    course = _Course(
        now_s=state.now_s,
        usual_step_s=state.usual_step_s,
        tracks=state.tracks,
        rules=tuple(_RuleMemory.of(rule, step) for rule, step in zip(state.plan.rules, state.rules.steps, strict=True)),
        first_out=state.rules.first_out,
        safety=state.safety,
        outputs=state.outputs,
        faults=state.faults,
        events=state.events,
        due=state.due,
        holds=state.holds,
        stopped=state.stopped,
    )
    return _ONE.dump_json((Continuation(continued=course),)).decode()


def read_continuation(text: str) -> Continuation:
    """Read it; `StateError` if the text is something else."""
    try:
        return _ONE.validate_json(text)[0]
    except ValidationError as error:
        raise StateError(f"not the state of a run: {error.errors()[0]['msg']}") from error
