"""What a run takes over from an earlier one: a value that a recording can hold, so that a replay begins with it too."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import ConfigDict, TypeAdapter, ValidationError

from stadimeter.app.persistence.alarm_store import Memory, upgraded
from stadimeter.app.persistence.moments import Moment, elapsed_s
from stadimeter.core.decide import State
from stadimeter.core.persistence import Absence, KeptAlarm, restored
from stadimeter.errors import StateError


@dataclass(frozen=True, slots=True, kw_only=True)
class Resumption:
    """What a run takes over from an earlier one.

    Attributes:
        alarms: What each alarm remembered, its times on the earlier run's clock.
        shift_s: What to add to these times.
        from_s: As of when the alarms remembered it, on the new run's clock.
        now_s: The beginning of the new run, on its clock.
        absent: Which targets were out of sight.
    """

    alarms: tuple[KeptAlarm, ...]
    shift_s: float
    from_s: float
    now_s: float
    absent: tuple[Absence, ...] = ()

    def of(self, state: State) -> State:
        """Return the state with which to begin.

        Args:
            state: The state of a run that has not begun.

        Returns:
            The same, with alarms that remember.
        """
        return restored(state, self.alarms, self.absent, shift_s=self.shift_s, from_s=self.from_s, now_s=self.now_s)

    def text(self) -> str:
        """Return it as text, for a recording."""
        return _ONE.dump_json((self,)).decode()


_ONE: TypeAdapter[tuple[Resumption]] = TypeAdapter(tuple[Resumption], config=ConfigDict(ser_json_inf_nan="constants"))
"""A configuration can be given for a tuple, and not for a dataclass."""


def resumption_at(now: Moment, memory: Memory) -> Resumption:
    """Return what a run takes over that begins now.

    Returns:
        It, as if the alarms had gone on in between.
    """
    from_s = now.at_s - elapsed_s(memory.moment, now)
    shift_s = from_s - memory.moment.at_s
    return Resumption(alarms=memory.alarms, absent=memory.absent, shift_s=shift_s, from_s=from_s, now_s=now.at_s)


def read_resumption(text: str) -> Resumption:
    """Read what was taken over.

    Raises:
        StateError: The text is something else.
    """
    try:
        return _ONE.validate_json(upgraded(text))[0]
    except ValidationError as error:
        raise StateError(f"not what a run takes over from another: {error.errors()[0]['msg']}") from error
