"""Actions of an operator on alarms and outputs: one table.

It makes the operations of the control socket, the paths of the page and their OpenAPI document, the commands of the
command line with their help, and the actions of buttons. What an action does to an alarm is in `core.alarms.operating`.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Literal, Self

from msgspec import Struct

Takes = Literal["for_s", "one_shot", "key", "value"]


class OperatorAction(StrEnum):
    """An action, by its name in the configuration and in events.

    Attributes:
        summary: One line for the description of the API.
        more: A sentence or two beside it; may be empty.
        example: The words behind ``stadimeter alarm``; empty for an action on no rule.
        is_on_outputs: Whether it concerns every output, the camera or the run itself, and no rule.
        takes: What it takes beside the rule, who and why: a duration, ``for_s``, with ``one_shot``; or of a threshold
            its ``key``, and a ``value``.
    """

    summary: str
    more: str
    example: str
    is_on_outputs: bool
    takes: tuple[Takes, ...]

    def __new__(
        cls, name: str, summary: str = "", more: str = "", example: str = "", takes: tuple[Takes, ...] = ()
    ) -> Self:
        """Make a row; one with an ``example`` is an action on alarms."""
        action = str.__new__(cls, name)
        action._value_ = name
        action.summary, action.more, action.example, action.takes = summary, more, example, takes
        action.is_on_outputs = not example
        return action

    @property
    def command(self) -> str:
        """Its name at the control socket and on the command line."""
        return "ack" if self is OperatorAction.ACKNOWLEDGE else self.value

    @property
    def lets_outputs_act(self) -> bool:
        """True if its purpose is that outputs may act which stood still; from afar it needs more trust than others."""
        return self in {OperatorAction.RELEASE_OUTPUTS, OperatorAction.ARM, OperatorAction.CONFIRM_MOUNTING}

    @property
    def writes_file(self) -> bool:
        """True if the run writes a file for it; from afar it needs more trust than others."""
        return self is OperatorAction.CLIP

    @property
    def needs_value(self) -> bool:
        """True if it takes a value, so that it is for one rule and for no button."""
        return "value" in self.takes

    ACKNOWLEDGE = (
        "acknowledge", "Acknowledge an alarm",
        'A person has seen it. For rules with `ack = "required"`. An event records who acknowledged it, when and why.',
        'ack too-close --why "moved the ladder"',
    )  # fmt: skip
    RESET = (
        "reset", "End a latched alarm", "Its condition must be over. A rule that counts counts anew.",
        "reset too-close",
    )  # fmt: skip
    SHELVE = (
        "shelve", "Keep a rule quiet for a while",
        "It is still evaluated, but drives nothing and notifies no one. A rule of severity `safety` cannot be shelved.",
        'shelve too-close --for "30 min" --why "painting"', ("for_s", "one_shot"),
    )  # fmt: skip
    UNSHELVE = ("unshelve", "Let a shelved rule act again", "", "unshelve --all")
    TAKE_OUT = (
        "take-out", "Take a rule out of service",
        "Until it is put back it drives nothing and notifies no one, also after a restart. No rule of `safety`.",
        'take-out too-close --why "the door is being repaired"',
    )  # fmt: skip
    PUT_BACK = ("put-back", "Put a rule back into service", "", "put-back too-close")
    OBSERVE = (
        "observe", "Let a rule be observed only",
        "As with `observe = true` it drives nothing and sends nothing, also after a restart. No rule of `safety`.",
        'observe too-close --why "trying its new threshold"',
    )  # fmt: skip
    ACT = (
        "act", "Let a rule act that was only observed", "An operator had let it be observed only.", "act too-close",
    )  # fmt: skip
    SET_THRESHOLD = (
        "set-threshold", "Move a threshold of a rule",
        "Bounded as in the configuration; until withdrawn, or a reload changes this threshold. None of `safety`.",
        'set-threshold too-close "60 cm"', ("key", "value"),
    )  # fmt: skip
    WITHDRAW_THRESHOLD = (
        "withdraw-threshold", "Return a threshold to what the configuration says",
        "Without --key, every threshold of the rule that was set.", "withdraw-threshold too-close", ("key",),
    )  # fmt: skip
    STOP_OUTPUTS = ("stop-outputs", "Put every output at its safe value, until they are released")
    RELEASE_OUTPUTS = ("release-outputs", "Let outputs that were stopped act again")
    ARM = ("arm", "Let outputs act from now on")
    DISARM = ("disarm", "Put every output at its safe value, until the run is armed")
    CLIP = ("clip", "Write the last seconds as a clip")
    CONFIRM_MOUNTING = ("confirm-mounting", "Confirm that the camera may be as it is now")


# A switch, such as Home Assistant's, sends both of its states to one topic, as `value`: true is the first action.
SWITCHES: Mapping[str, tuple[OperatorAction, OperatorAction]] = {
    "in-service": (OperatorAction.PUT_BACK, OperatorAction.TAKE_OUT),
    "observed": (OperatorAction.OBSERVE, OperatorAction.ACT),
}


# Commands of people to a running rule: that they have seen an alarm, that it shall be quiet for a while ---------------


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
