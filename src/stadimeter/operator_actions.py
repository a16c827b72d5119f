"""What an operator can do to alarms and outputs: one table.

It makes the operations of the control socket, the paths of the page and their OpenAPI document, the commands of the
command line with their help, and the actions of buttons. What an action does to an alarm is in `core.alarms.alarm`.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Self


class OperatorAction(StrEnum):
    """An action, by its name in the configuration and in events.

    Attributes:
        command: Its name at the control socket and on the command line.
        summary: One line for the description of the API.
        help: The text of ``--help``; empty for an action that shares the command of another.
        is_on_outputs: Whether it concerns every output, and no rule.
        is_timed: Whether it takes a duration, ``for_s``, and ``one_shot``.
    """

    command: str
    summary: str
    help: str
    is_on_outputs: bool
    is_timed: bool

    def __new__(
        cls,
        name: str,
        summary: str = "",
        help: str = "",  # noqa: A002 - as typer calls it
        command: str = "",
        is_on_outputs: bool = False,
        is_timed: bool = False,
    ) -> Self:
        """Make a row."""
        action = str.__new__(cls, name)
        action._value_ = name
        action.command, action.summary, action.help = command or name, summary, help
        action.is_on_outputs, action.is_timed = is_on_outputs, is_timed
        return action

    ACKNOWLEDGE = (
        "acknowledge",
        "Acknowledge an alarm",
        """Acknowledge an alarm of a running instance: a person has seen it.

        For rules with `ack = "required"`. An event records who acknowledged it, when and why.

        **Example**

        - `stadimeter alarm ack too-close --why "moved the ladder"`

        **Exit code**: 0 done; 2 there is nothing to acknowledge, no such rule, or no running instance.
        """,
        "ack",
    )
    RESET = (
        "reset",
        "End a latched alarm",
        """End a latched alarm of a running instance. Its condition must be over.

        **Example**

        - `stadimeter alarm reset too-close`

        **Exit code**: 0 done; 2 it is not latched, its condition still holds, no such rule, or no running instance.
        """,
    )
    SHELVE = (
        "shelve",
        "Keep a rule quiet for a while",
        """Shelve a rule of a running instance: for a while it is still evaluated, but drives nothing.

        It notifies no one either, and acts again by itself when the time is over. A rule of severity `safety` cannot be
        shelved.

        **Example**

        - `stadimeter alarm shelve too-close --for "30 min" --why "painting"`

        **Exit code**: 0 done; 2 the rule does not allow it, no such rule, or no running instance.
        """,
        "",
        False,
        True,
    )
    UNSHELVE = (
        "unshelve",
        "Let a shelved rule act again",
        """Let a shelved rule of a running instance act again.

        **Example**

        - `stadimeter alarm unshelve --all`

        **Exit code**: 0 done; 2 it is not shelved, no such rule, or no running instance.
        """,
    )
    TAKE_OUT = (
        "take-out",
        "Take a rule out of service",
        """Take a rule of a running instance out of service, until it is put back.

        The rule is still evaluated, but drives nothing and notifies no one, also after a restart. A rule of severity
        `safety` cannot be taken out.

        **Example**

        - `stadimeter alarm take-out too-close --why "the door is being repaired"`

        **Exit code**: 0 done; 2 it is a safety rule, no such rule, or no running instance.
        """,
    )
    PUT_BACK = (
        "put-back",
        "Put a rule back into service",
        """Put a rule of a running instance back into service.

        **Example**

        - `stadimeter alarm put-back too-close`

        **Exit code**: 0 done; 2 it is not out of service, no such rule, or no running instance.
        """,
    )
    STOP_OUTPUTS = (
        "stop-outputs",
        "Put every output at its safe value, until they are released",
        """Put every output of a running instance at its safe value, until they are released.

        Every actuator goes to its `safe` level, a base stands still, and all holds end. No rule stands before that,
        of whatever severity; alarms are raised and announced as ever. It outlasts a reload, and a restart of a run that
        keeps its state. If several instances run and none is named, all are stopped. It is no emergency stop: that is a
        switch in the supply.

        **Examples**

        - `stadimeter stop-outputs --why "a child is in the room"`

        - `stadimeter stop-outputs --release`

        **Exit code**: 0 done, also if it was done already; 2 no instance runs, or one of them does not answer.
        """,
        "",
        True,
    )
    RELEASE_OUTPUTS = ("release-outputs", "Let outputs that were stopped act again", "", "", True)
