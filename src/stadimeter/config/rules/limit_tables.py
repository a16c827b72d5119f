"""The tables of limits on a figure and of how sure it must be, and the core's conditions of them.

Annotations are no texts here, as in every file of tables.
"""

from typing import Annotated, ClassVar, TypedDict

from pydantic import BeforeValidator, Field, WithJsonSchema

from stadimeter.config.models import DurationAboveZero, Section
from stadimeter.config.units import Duration, LengthOrZero, Speed
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.decision import Severity

# A safety rule acts as soon as danger is as likely as not.
PROBABILITY_FOR_SAFETY = 0.5

_DISTANCE = DistanceCondition()
_CONTACT = TimeToContactCondition(below_s=1.0)

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
        """The values the figure must be above and below, in the SI unit; None for no such limit."""
        if self.between is not None:
            return self.between[0], self.between[1]
        return self.above, self.below


class Likelihood(TypedDict):
    """The certainty it needs, as the conditions of the core have it."""

    deadband_sigmas: float
    probability_on: float | None
    probability_off: float


class LikelihoodTable(Section):
    """The certainty needed that a figure is within its limits."""

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
