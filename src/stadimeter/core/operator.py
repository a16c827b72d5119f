"""Commands of people to a running rule: that they have seen an alarm, that it shall be quiet for a while."""

from __future__ import annotations

from msgspec import Struct

from stadimeter.operator_actions import OperatorAction


class OperatorCommand(Struct, frozen=True, kw_only=True, tag=True):
    """One such wish.

    Attributes:
        id: Identifies it, so that its answer finds back.
        rule: The rule; empty for every rule that the action applies to.
        why: Why, in their words; may be empty.
        for_s: How long to shelve; None for as long as the rule allows.
        one_shot: Shelve until the alarm has returned to normal, or the time is over.
        key: Which threshold of the rule is meant; empty for the only one.
        value: What it is set to, in the SI unit.
        unit: The SI unit of the value as it was given; empty for a number without one.
        is_from_button: A push button gave it, so a person stands beside what will move.
    """

    id: str
    action: OperatorAction
    rule: str = ""
    by: str = ""
    why: str = ""
    for_s: float | None = None
    one_shot: bool = False
    key: str = ""
    value: float | None = None
    unit: str = ""
    is_from_button: bool = False

    @property
    def said(self) -> str:
        """The person who wants it and why, such as ``by zoe: on my way``."""
        who = f"by {self.by}" if self.by else "by an operator"
        return f"{who}: {self.why}" if self.why else who


class HoldCommand(Struct, frozen=True, kw_only=True, tag=True):
    """A person holds an output for a moment, to try it, or lets go of it.

    Attributes:
        level: For an actuator, from 0 to 1.
        linear_mps: For a base: speed forwards.
        angular_radps: For a base: rate of turn, positive to the left.
        is_release: Whether it ends a hold.
    """

    id: str
    output: str
    level: float | None = None
    linear_mps: float | None = None
    angular_radps: float | None = None
    is_release: bool = False
    by: str = ""


AnyCommand = OperatorCommand | HoldCommand


class OperatorAnswer(Struct, frozen=True, kw_only=True):
    """Outcome of an operator's command.

    Attributes:
        words: What was done, or why not.
    """

    id: str
    accepted: bool
    words: str
