"""What one rule wants of one output."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelRequest:
    """A rule wants an actuator to act.

    Attributes:
        rule: The rule's name.
        output: The actuator's name.
        priority: Of several requests for one output, the highest wins.
        level: From 0 to 1.
    """

    rule: str
    output: str
    priority: int
    level: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TwistRequest:
    """A rule wants a base to move, or to stand still.

    Attributes:
        rule: The rule's name.
        output: The base's name.
        priority: Of several requests for one output, the highest wins.
        linear_mps: Speed forwards.
        angular_radps: Rate of turn, positive to the left.
    """

    rule: str
    output: str
    priority: int
    linear_mps: float
    angular_radps: float


Request = LevelRequest | TwistRequest
