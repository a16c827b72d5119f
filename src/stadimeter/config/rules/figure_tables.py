"""The tables of limits on any quantity of a target, and of comparisons of two targets.

Annotations are no texts here, as in every file of tables.
"""

from typing import Annotated, Any, ClassVar, NamedTuple

from pydantic import BeforeValidator, Discriminator, Field, Tag

from stadimeter.config.rules.limit_tables import (
    PROBABILITY_OF_SPEED_FOR_SAFETY,
    LikelihoodTable,
    LimitsTable,
    Probability,
    Sigmas,
)
from stadimeter.config.units import (
    ANGLES_RAD,
    LENGTHS_M,
    SPEEDS_MPS,
    AngleOrZero,
    Coordinate,
    LengthOrZero,
    Speed,
    Units,
    Velocity,
    as_written,
    parse_any_quantity,
    parse_quantity,
)
from stadimeter.core.conditions.limits import ClosingCondition
from stadimeter.core.conditions.measured import COMPARISONS, ComparisonCondition, FigureCondition
from stadimeter.core.conditions.quantities import MAX_SIZE, QUANTITIES, SIZE_UNIT, QuantityName, noun_of
from stadimeter.core.decision import Severity

SIZES = Units(MAX_SIZE, {SIZE_UNIT: 1.0, "%": 0.01})

_CLOSING = ClosingCondition()


class _Written(NamedTuple):
    """How a quantity is written."""

    units: Units
    kind: str
    example: str


_WRITTEN = {
    "m": _Written(LENGTHS_M, "a length", "2 m"),
    "rad": _Written(ANGLES_RAD, "an angle", "20 deg"),
    "m/s": _Written(SPEEDS_MPS, "a speed", "0.5 m/s"),
    SIZE_UNIT: _Written(SIZES, "a share of the picture's width", "20 %"),
}

_ANY = Units(LENGTHS_M.most, {unit: size for each in _WRITTEN.values() for unit, size in each.units.items()})


def _check_text(value: object) -> object:
    if not isinstance(value, str):
        parse_quantity(value, _ANY, "2 m")
    return value


# The text of a figure of some quantity, which `parse_figure` reads once the quantity is known.
WrittenFigure = Annotated[str, BeforeValidator(_check_text), as_written(_ANY, "2 m", is_signed=True)]


def parse_figure(text: object, quantity: QuantityName) -> float:
    """Read a figure of a quantity, such as ``"20 deg"`` of a bearing; return it in the SI unit.

    Raises:
        ValueError: It is none, has the unit of another quantity, or is below zero where the quantity cannot be.
    """
    units, kind, example = _WRITTEN[QUANTITIES[quantity].unit]
    try:
        value = parse_quantity(text, units, example)
    except ValueError:
        unit = _unit_of(text)
        if unit and unit != units.si_unit:
            raise ValueError(
                f"{text!r} is in {unit}, and the {noun_of(quantity)} is {kind}, such as {example!r}"
            ) from None
        raise
    if value < 0 and not QUANTITIES[quantity].is_signed:
        raise ValueError(f"{text!r} is below zero")
    return value


def _unit_of(text: object) -> str:
    """Return the SI unit of a text with a unit of any quantity; empty for what is none."""
    try:
        return parse_any_quantity(text)[1] if isinstance(text, str) else ""
    except ValueError:
        return ""


Size = Annotated[float, BeforeValidator(lambda text: parse_figure(text, "size")), as_written(SIZES, "20 %")]


class FigureTable(LimitsTable, LikelihoodTable):
    """A condition on a quantity of the target."""

    deadband: float = 0.0
    """How far the figure must come back, in the SI unit."""

    def to_plan(self, quantity: QuantityName, severity: Severity, target: str) -> FigureCondition:
        """Return the condition as the core sees it."""
        above, below = self.limits
        return FigureCondition(
            quantity=quantity,
            above=above,
            below=below,
            deadband=self.deadband,
            **self.likelihood(severity),
            target=target,
        )


class PlaceTable(FigureTable):
    """A condition on where the target is, along one axis or above something."""

    above: Coordinate | None = None
    """In metres."""
    below: Coordinate | None = None
    """In metres."""
    between: Annotated[list[Coordinate], Field(min_length=2, max_length=2)] | None = None
    """In metres."""
    deadband: LengthOrZero = 0.0
    """In metres; how far the target must come back."""


class SpeedTable(FigureTable):
    """A condition on a speed across the line of sight, or in all directions."""

    above: Velocity | None = None
    """In m/s."""
    below: Velocity | None = None
    """In m/s."""
    between: Annotated[list[Velocity], Field(min_length=2, max_length=2)] | None = None
    """In m/s."""
    deadband: Speed = 0.0
    """In m/s; how far the speed must come back."""
    deadband_sigmas: Sigmas = _CLOSING.deadband_sigmas
    probability: Probability = _CLOSING.probability_on
    probability_for_safety: ClassVar[float] = PROBABILITY_OF_SPEED_FOR_SAFETY


class SizeTable(FigureTable):
    """A condition on how large the target appears in the picture."""

    above: Size | None = None
    """As a share of the picture's width."""
    below: Size | None = None
    """As a share of the picture's width."""
    between: Annotated[list[Size], Field(min_length=2, max_length=2)] | None = None
    """As shares of the picture's width."""
    deadband: Size = 0.0
    """As a share of the picture's width; how much it must shrink or grow back."""


class ComparisonTable(LikelihoodTable):
    """A condition on how a target is in relation to another one; `by` and `deadband` are lengths."""

    target: str
    """The other target."""
    by: LengthOrZero = 0.0
    """In metres; how much nearer, further, higher or lower at least."""
    deadband: LengthOrZero = 0.0
    """In metres; how far the difference must come back."""

    def to_plan(self, key: str, severity: Severity, target: str) -> ComparisonCondition:
        """Return the condition as the core sees it.

        Args:
            key: One of `COMPARISONS`.
        """
        quantity, is_more = COMPARISONS[key]
        return ComparisonCondition(
            quantity=quantity,
            above=self.by if is_more else None,
            below=None if is_more else 0.0 - self.by,
            deadband=self.deadband,
            **self.likelihood(severity),
            target=target,
            other=self.target,
        )


class DirectionComparisonTable(ComparisonTable):
    """The same for directions; `by` and `deadband` are angles."""

    by: AngleOrZero = 0.0
    """In radians; how much further to that side at least."""
    deadband: AngleOrZero = 0.0
    """In radians; how far the difference must come back."""


def _form(value: object) -> str:
    return "name" if isinstance(value, str) else "table"


# The name of the other target alone, or a table.
Comparison = Annotated[Annotated[ComparisonTable, Tag("table")] | Annotated[str, Tag("name")], Discriminator(_form)]
DirectionComparison = Annotated[
    Annotated[DirectionComparisonTable, Tag("table")] | Annotated[str, Tag("name")], Discriminator(_form)
]


def comparison_of(written: Any) -> ComparisonTable:
    """Return the table of a comparison, of which the name of the other target may stand alone."""
    return ComparisonTable(target=written) if isinstance(written, str) else written
