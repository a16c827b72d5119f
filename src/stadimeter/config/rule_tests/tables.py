"""The tables ``[[tests]]``: what the target does, and what is expected of the rules."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from stadimeter.config.models import DurationAboveZero, Section
from stadimeter.config.paths import FilePath
from stadimeter.config.rule_tests.expectations import ExpectTable
from stadimeter.config.rule_tests.motions import MotionTable, SpanTable
from stadimeter.config.units import Duration, Frequency, TimeOfDay
from stadimeter.core.operator import OperatorAction

FRAMES_MAX = 1_000_000
"""The longest test, in frames: nine hours at 30 a second. More is a slip of the pen."""


def _parse_noise(value: object) -> float:
    if value in ("model", "none"):
        return 1.0 if value == "model" else 0.0
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 100:
        raise ValueError(f"{value!r} is neither 'model' nor 'none', nor a factor from 0 to 100")
    return float(value)


Noise = Annotated[float, BeforeValidator(_parse_noise)]
Rate = Annotated[Frequency, Field(gt=0, le=1000)]
Rare = Annotated[float, Field(ge=0, lt=1)]


class OperatorTable(Section):
    """What somebody tells a rule at some time; exactly one of the keys that name an action holds the rule's name.

    Attributes:
        at: In seconds from the start of the test.
        acknowledge: Acknowledge this rule.
        reset: Reset it.
        shelve: Keep it quiet.
        unshelve: Let it speak again.
        take_out: Take it out of service.
        put_back: Put it back into service.
        duration: How long to shelve it, written ``for``, in seconds; None for as long as the rule allows.
        one_shot: Shelve it until it has returned to normal, or the time is over.
        by: Who does it.
        why: Why.
    """

    at: Duration
    acknowledge: str | None = None
    reset: str | None = None
    shelve: str | None = None
    unshelve: str | None = None
    take_out: str | None = None
    put_back: str | None = None
    duration: Annotated[DurationAboveZero | None, Field(alias="for")] = None
    one_shot: bool = False
    by: str = "test"
    why: str = ""

    def orders(self) -> tuple[tuple[OperatorAction, str], ...]:
        """Return what is to be done to which rule; more or fewer than one is wrong."""
        named = ((action, getattr(self, action.replace("-", "_"))) for action in OperatorAction)
        return tuple((action, rule) for action, rule in named if rule is not None)


class InputTable(MotionTable):
    """What the camera sees in a test, and what people do. Without a journal it is made up.

    Attributes:
        target: The target that moves, where there are several; the others are out of sight.
        targets: How each of several targets moves, by its name.
        journal: A recording that takes the place of all this, relative to the configuration.
        noise: How noisy measured distances are, as a factor of what camera and target are expected to give.
        dropouts: The share of frames in which a target is not found.
        outliers: The share of frames in which a distance is grossly wrong.
        rate: Frames in a second, in hertz; None for the camera's, or 30.
        seed: Everything random follows from it.
        frozen: When the camera gives no frames.
        clock: The time of day at the start, in seconds after midnight; None for a clock that is not synchronised.
        day: The day of the week at the start.
        operator: What people tell rules.
    """

    target: str | None = None
    targets: dict[str, MotionTable] | None = None
    journal: FilePath | None = None
    noise: Noise = 1.0
    dropouts: Rare = 0.0
    outliers: Rare = 0.0
    rate: Rate | None = None
    seed: Annotated[int, Field(ge=0)] = 1
    frozen: list[SpanTable] = Field(default_factory=list)
    clock: TimeOfDay | None = None
    day: Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"] = "mon"
    operator: list[OperatorTable] = Field(default_factory=list)

    def motions(self, targets: Sequence[str]) -> Mapping[str, MotionTable]:
        """Return how each target moves.

        Args:
            targets: The names of all targets.

        Returns:
            The motions by target; without those that are never in sight.
        """
        if self.targets is not None:
            return self.targets
        return {self.target or targets[0]: self}

    @property
    def moving_s(self) -> float:
        """How long the test is, in seconds; 0 for a recording."""
        motions = self.targets.values() if self.targets else (self,)
        return max((motion.duration_s for motion in motions), default=0.0)


class RuleTestTable(Section):
    """One test.

    Attributes:
        name: What it shows; None for one by its number.
        input: What happens.
        expect: What is expected, by the name of a rule or an output.
    """

    name: Annotated[str, Field(min_length=1)] | None = None
    input: InputTable
    expect: dict[str, ExpectTable]


@dataclass(frozen=True, slots=True, kw_only=True)
class RuleTest:
    """One test of a configuration.

    Attributes:
        name: What it shows.
        line: Where it stands in the file, counted from 1.
        input: What happens.
        expect: What is expected, by the name of a rule or an output.
    """

    name: str
    line: int
    input: InputTable
    expect: Mapping[str, ExpectTable]


def name_of(table: RuleTestTable, position: int) -> str:
    """Return the name of a test.

    Args:
        table: Its table.
        position: Its position among the tests, counted from 0.

    Returns:
        The name; ``test 1`` for a first one without.
    """
    return table.name or f"test {position + 1}"
