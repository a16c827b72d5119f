"""The core's decision in one cycle, and the reasons for it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import StrEnum

from msgspec import Struct, field

from stadimeter.core.command import Command
from stadimeter.core.measurement import Track
from stadimeter.operator_actions import OperatorAnswer


class EventKind(StrEnum):
    """The kind of thing that happened."""

    RAISED = "raised"
    CLEARED = "cleared"
    MEASUREMENT_LOST = "measurement_lost"
    """A rule has waited too long for its target; its output went to the safe value."""
    MEASUREMENT_BACK = "measurement_back"
    TARGET_SEEN = "target_seen"
    TARGET_LOST = "target_lost"
    FAULT = "fault"
    FAULT_CLEARED = "fault_cleared"
    ACKNOWLEDGED = "acknowledged"
    RESET = "reset"
    """A person ended an alarm that latched."""
    REALARMED = "realarmed"
    """An alarm still stands, and is reported again."""
    SHELVED = "shelved"
    UNSHELVED = "unshelved"
    SUPPRESSED = "suppressed"
    UNSUPPRESSED = "unsuppressed"
    OUT_OF_SERVICE = "out_of_service"
    IN_SERVICE = "in_service"
    THRESHOLD_SET = "threshold_set"
    """An operator has moved a threshold of a rule."""
    THRESHOLD_WITHDRAWN = "threshold_withdrawn"
    """A threshold is again as the configuration has it."""
    OBSERVED = "observed"
    """An operator lets a rule be observed only: it drives nothing and sends nothing."""
    ACTING = "acting"
    """A rule that was only observed acts again."""
    CHATTERING = "chattering"
    """An alarm came too often within a minute; it stays active until it has calmed down."""
    CALMED = "calmed"
    """An alarm that was chattering is an ordinary one again."""
    REPORT = "report"
    """It is time for a message of a rule; this is in the message, and among no events."""
    REFUSED = "refused"
    """What an operator wanted could not be done."""
    STOPPED = "stopped"
    """A person has stopped every output."""
    RELEASED = "released"
    DISARMED = "disarmed"
    """Every output is kept at its safe value until the run is armed: a person wants it, or something failed."""
    ARMED = "armed"
    SEARCH_BEGUN = "search_begun"
    """A base has lost its target, and turns to find it."""
    SEARCH_ENDED = "search_ended"
    """It has not found it, and stands still."""
    TETHERED = "tethered"
    """A base is as far from where it began as it may go."""
    LIVENESS_UNKNOWN = "liveness_unknown"
    """The room is too plain to tell a frozen picture from a live one while the robot drives."""


# What does not happen to a rule.
SYSTEM_EVENTS = {
    EventKind.TARGET_SEEN,
    EventKind.TARGET_LOST,
    EventKind.FAULT,
    EventKind.FAULT_CLEARED,
    EventKind.STOPPED,
    EventKind.RELEASED,
    EventKind.DISARMED,
    EventKind.ARMED,
    EventKind.LIVENESS_UNKNOWN,
}
ALARM_EVENTS = tuple(kind for kind in EventKind if kind not in SYSTEM_EVENTS)


class Severity(StrEnum):
    """Importance of an event, least first."""

    INFO = "info"
    WARNING = "warning"
    ALARM = "alarm"
    SAFETY = "safety"


_RANKS = {severity: rank for rank, severity in enumerate(Severity)}


def first_to_go(severities: Iterable[Severity]) -> int | None:
    """Return the position of what is given up first where too much waits: the first of what matters least.

    None if there is nothing but what is about safety, which is never given up for want of room.
    """
    rank, position = min(((_RANKS[each], position) for position, each in enumerate(severities)), default=(0, None))
    return None if rank == _RANKS[Severity.SAFETY] else position


class Event(Struct, frozen=True, kw_only=True):
    """Something that happened once and must not be lost.

    Attributes:
        source: The rule, target or output it happened to, ``outputs`` for all of them, or ``camera``.
        at_s: When, on the run's monotonic clock.
        sequence: Counts the events of the run, from 0.
        notify: Whether people are to be notified: not while the rule is shelved, suppressed, out of service or only
            observed, nor within its cooldown.
        by: Who caused it; empty where no one did.
    """

    kind: EventKind
    source: str
    at_s: float
    severity: Severity
    reason: str
    distance_m: float | None = None
    sigma_m: float | None = None
    sequence: int = 0
    notify: bool = True
    first_out: bool = False
    by: str = ""


class Notice(Struct, frozen=True, kw_only=True):
    """A message or notification that a rule sends now.

    Attributes:
        step: The position of the step in its escalation that sends it.
        count: How often the alarm has been raised so far.
    """

    rule: str
    step: int
    event: Event
    count: int = 0


class RuleStatus(StrEnum):
    """Current state of a rule."""

    IDLE = "idle"
    """Its condition does not hold."""
    PENDING = "pending"
    """Its condition holds, but not yet for long enough."""
    ACTIVE = "active"
    CLEARING = "clearing"
    """Its condition no longer holds, but not yet for long enough."""
    LATCHED = "latched"
    """Its condition is over, but it stands until it is reset."""
    RETURNED = "returned"
    """Its condition is over, but no one has acknowledged it."""
    UNKNOWN = "unknown"
    """There is nothing to judge by: its target is not seen."""


class RuleTrace(Struct, frozen=True, kw_only=True):
    """Account of one rule in one cycle. Why is in `Decision.reasons`, and whether it won its output in `OutputTrace`.

    Attributes:
        acknowledged: Whether no one needs to acknowledge it, or someone has.
        inhibits: What keeps it from acting: ``shelved``, ``suppressed``, ``out of service``, ``observed``.
        active: Whether the rule is active: of an alarm, whether it is raised, clearing or latched. None if it is not
            and there is nothing to judge by. This is the one answer: for other rules, messages, tests and figures.
        chattering: Whether it came too often within a minute, and stays active until it has calmed down.
    """

    rule: str
    status: RuleStatus
    output: str | None = None
    acknowledged: bool = True
    inhibits: tuple[str, ...] = ()
    first_out: bool = False
    active: bool | None = None
    chattering: bool = False

    @property
    def active_or_unknown(self) -> bool | None:
        """True while it is active; None also where its policy for a lost target has let it go."""
        return self.active or (None if self.status is RuleStatus.UNKNOWN else self.active)


class OutputTrace(Struct, frozen=True, kw_only=True):
    """The winner of one output in one cycle, and those who would have liked to command it.

    Attributes:
        winner: The rule that commands it, ``safety``, ``operator``, or ``safe`` if no rule makes a request.
        reason: Why safety commands it, or no rule does; empty if one does, whose reason is in `Decision.reasons`.
        losers: The rules that asked too, with less priority.
        held_by: Who holds it to try it; empty if no one does.
    """

    output: str
    winner: str
    reason: str = ""
    losers: tuple[str, ...] = ()
    held_by: str = ""


class SafetyMode(StrEnum):
    """Modes of safety, which say whether outputs may act."""

    STARTING = "starting"
    """Not enough fresh frames yet: every output is kept at its safe value."""
    ACTIVE = "active"
    STALE = "stale"
    """The newest frame is too old: every output is kept at its safe value."""
    STOPPED = "stopped"
    """A person has stopped every output: each is kept at its safe value until they are released."""
    DISARMED = "disarmed"
    """The run was not armed yet, or has lost that: every output is kept at its safe value until it is armed."""


class Decision(Struct, frozen=True, kw_only=True, eq=False):
    """The core's decision in one cycle.

    Attributes:
        commands: Exactly one for each output, in the order of the configuration.
        safety_reason: Why they may not; empty if they may.
        rules: What each rule did, in the order of the configuration.
        figures: The remembered figures that rules were judged by, by name; None for one that is not known.
        reasons: Why each rule did so, by its name, in words with figures. They follow from the plan and the other
            fields, so they are put into words only when they are read, are in no journal, and do not count when
            decisions are compared.
    """

    commands: tuple[Command, ...]
    events: tuple[Event, ...]
    tracks: tuple[Track, ...]
    safety: SafetyMode
    safety_reason: str
    outputs: tuple[OutputTrace, ...]
    rules: tuple[RuleTrace, ...]
    notices: tuple[Notice, ...] = ()
    answers: tuple[OperatorAnswer, ...] = ()
    figures: Mapping[str, float | None] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)

    def __eq__(self, other: object) -> bool:
        """Compare everything but the reasons."""
        if not isinstance(other, Decision):
            return NotImplemented
        compared = (name for name in self.__struct_fields__ if name != "reasons")
        return all(getattr(self, name) == getattr(other, name) for name in compared)

    def __ne__(self, other: object) -> bool:
        """Likewise: a struct has a comparison of its own for this, which `__eq__` does not replace."""
        return not self == other

    __hash__ = None  # type: ignore[assignment]
