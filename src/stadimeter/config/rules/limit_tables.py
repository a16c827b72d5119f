"""The tables of limits on a figure and of how sure it must be, and the core's conditions of them.

Annotations are no texts here, as in every file of tables.
"""

from typing import Annotated, ClassVar, TypedDict

from pydantic import BeforeValidator, Field, WithJsonSchema

from stadimeter.config.models import DurationAboveZero, Section
from stadimeter.config.units import Angle, AngleOrZero, Duration, Length, LengthOrZero, Speed, Velocity
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.figures import Direction
from stadimeter.core.conditions.limits import ClosingCondition, DirectionCondition, SeparationCondition
from stadimeter.core.decision import Severity

# A safety rule acts as soon as danger is as likely as not.
PROBABILITY_FOR_SAFETY = 0.5

# A speed is estimated from many frames, and overshoots for some tenths of a second after a target has set off. At even
# odds the estimate alone decides, and every third target that sets off to 70 % of a limit is taken to be above it; at
# 0.8 its standard deviation, which says that it has not settled, keeps all but 1 in 50 out. A target at twice the limit
# is found 0.1 s later, one at 1.1 times 0.3 to 0.6 s. Measured by ``tests/benchmarks/closing_speeds.py``.
PROBABILITY_OF_SPEED_FOR_SAFETY = 0.8

_DISTANCE = DistanceCondition()
_DIRECTION = DirectionCondition()
_CLOSING = ClosingCondition()
_CONTACT = TimeToContactCondition(below_s=1.0)
_SEPARATION = SeparationCondition(targets=("", ""))

_Bounds = tuple[float | None, float | None]


def _parse_probability(value: object) -> float | None:
    if value == "none":
        return None
    if isinstance(value, int | float) and 0 < value < 1:  # neither of true and false is within
        return float(value)
    raise ValueError(f"{value!r} is not a probability between 0 and 1, such as 0.8, and not 'none'")


_BETWEEN_0_AND_1 = {"type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1}

Probability = Annotated[
    float | None, BeforeValidator(_parse_probability), WithJsonSchema({"anyOf": [_BETWEEN_0_AND_1, {"const": "none"}]})
]
ProbabilityOff = Annotated[float, Field(gt=0, lt=1)]
Sigmas = Annotated[float, Field(ge=0)]


class LimitsTable(Section):
    """Limits on a figure."""

    above: float | None = None
    """Holds above this."""
    below: float | None = None
    """Holds below this."""
    between: list[float] | None = None
    """The same two at once, the lower end first."""

    @property
    def limits(self) -> _Bounds:
        """What the figure must be above and below, in the SI unit; None for no such limit."""
        if self.between is not None:
            return self.between[0], self.between[1]
        return self.above, self.below


class Likelihood(TypedDict):
    """How sure it must be, as the conditions of the core have it."""

    deadband_sigmas: float
    probability_on: float | None
    probability_off: float


class LikelihoodTable(Section):
    """How sure it must be that a figure is within its limits."""

    deadband_sigmas: Sigmas = _DISTANCE.deadband_sigmas
    """How many standard deviations of its noise the figure must come back before the condition ends."""
    probability: Probability = _DISTANCE.probability_on
    """How likely the condition must be to begin; None compares the figures alone."""
    probability_off: ProbabilityOff = _DISTANCE.probability_off
    """How likely it may be at most to end."""

    probability_for_safety: ClassVar[float] = PROBABILITY_FOR_SAFETY
    """How likely it must be for a safety rule that does not say so."""

    def likelihood(self, severity: Severity) -> Likelihood:
        """Return the same as the core sees it, for a rule that matters so much."""
        is_default = severity is Severity.SAFETY and "probability" not in self.model_fields_set
        return {
            "deadband_sigmas": self.deadband_sigmas,
            "probability_on": self.probability_for_safety if is_default else self.probability,
            "probability_off": self.probability_off,
        }


class DirectionTable(LimitsTable):
    """A condition on the bearing, positive to the right, or the elevation, positive upwards."""

    above: Angle | None = None
    """In radians."""
    below: Angle | None = None
    """In radians."""
    between: Annotated[list[Angle], Field(min_length=2, max_length=2)] | None = None
    """In radians."""
    deadband: AngleOrZero = _DIRECTION.deadband_rad
    """In radians; how far the target must come back."""

    def to_plan(self, quantity: Direction, target: str) -> DirectionCondition:
        """Return the condition as the core sees it."""
        above_rad, below_rad = self.limits
        return DirectionCondition(
            quantity=quantity, above_rad=above_rad, below_rad=below_rad, deadband_rad=self.deadband, target=target
        )


class ClosingTable(LimitsTable, LikelihoodTable):
    """A condition on the speed at which a target comes nearer; that of one that goes away is below zero."""

    above: Velocity | None = None
    """In m/s."""
    below: Velocity | None = None
    """In m/s."""
    between: Annotated[list[Velocity], Field(min_length=2, max_length=2)] | None = None
    """In m/s."""
    deadband: Speed = _CLOSING.deadband_mps
    """In m/s; how far the speed must come back."""
    deadband_sigmas: Sigmas = _CLOSING.deadband_sigmas
    probability: Probability = _CLOSING.probability_on
    probability_for_safety: ClassVar[float] = PROBABILITY_OF_SPEED_FOR_SAFETY

    def to_plan(self, severity: Severity, target: str) -> ClosingCondition:
        """Return the condition as the core sees it."""
        above_mps, below_mps = self.limits
        return ClosingCondition(
            above_mps=above_mps,
            below_mps=below_mps,
            deadband_mps=self.deadband,
            **self.likelihood(severity),
            target=target,
        )


class ContactTable(LikelihoodTable):
    """A condition on how soon a target will be here, if it goes on as it does."""

    below: DurationAboveZero
    """In seconds."""
    contact: LengthOrZero = _CONTACT.contact_m
    """In metres; the distance that counts as contact."""
    min_closing_speed: Speed = _CONTACT.closing_min_mps
    """In m/s; a target that is slower does not come at all."""
    speed_sigmas: Sigmas = _CONTACT.speed_sigmas
    """How many standard deviations the speed must be above zero to be known."""
    deadband: Duration = _CONTACT.deadband_s
    """In seconds; how much later the contact must be before the condition ends."""
    deadband_sigmas: Sigmas = _CONTACT.deadband_sigmas

    def to_plan(self, severity: Severity, target: str) -> TimeToContactCondition:
        """Return the condition as the core sees it."""
        return TimeToContactCondition(
            below_s=self.below,
            contact_m=self.contact,
            closing_min_mps=self.min_closing_speed,
            speed_sigmas=self.speed_sigmas,
            deadband_s=self.deadband,
            **self.likelihood(severity),
            target=target,
        )


class SeparationTable(LimitsTable, LikelihoodTable):
    """A condition on how far two targets are from each other."""

    of: Annotated[list[str], Field(min_length=2, max_length=2)]
    """The two targets."""
    above: Length | None = None
    """In metres."""
    below: Length | None = None
    """In metres."""
    between: Annotated[list[Length], Field(min_length=2, max_length=2)] | None = None
    """In metres."""
    deadband: LengthOrZero = _SEPARATION.deadband_m
    """In metres; how far they must come back."""

    def to_plan(self, severity: Severity) -> SeparationCondition:
        """Return the condition as the core sees it."""
        above_m, below_m = self.limits
        return SeparationCondition(
            targets=(self.of[0], self.of[1]),
            above_m=above_m,
            below_m=below_m,
            deadband_m=self.deadband,
            **self.likelihood(severity),
        )
