"""The requests that a running instance takes: one JSON object a line, and one line of JSON in answer.

::

    {"transaction": "7", "op": "ack", "args": {"rule": "too-close", "by": "zoe", "why": "seen"}}
    {"transaction": "7", "status": "ok", "data": {"words": "acknowledged too-close"}}
    {"transaction": "7", "status": "error", "error": "there is nothing to acknowledge"}

``transaction`` is whatever the one who asks likes, and comes back with the answer. After the requests of Zigbee2MQTT.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Struct
from pydantic import BaseModel, ConfigDict, Field, PlainValidator, StringConstraints, ValidationError, create_model

from stadimeter.app.control.client import encode_line
from stadimeter.app.exact_json import plain
from stadimeter.config.units import parse_any_quantity
from stadimeter.core.bounds import MAX_DURATION_S, MAX_PLAIN, MAX_TIME_S
from stadimeter.core.rules.explaining import Explanation
from stadimeter.errors import ControlError, Problem
from stadimeter.operator_actions import AnyCommand, HoldCommand, OperatorAction, OperatorCommand, Takes

# A longer line is no request.
LINE_MAX_BYTES = 64 * 1024

# A longer text is no quantity.
VALUE_MAX_LENGTH = 100

_Words = Annotated[str, StringConstraints(max_length=500, pattern=r"^[^\x00-\x1f\x7f-\x9f]*$")]
_Name = Annotated[str, StringConstraints(max_length=200, pattern=r"^[^\x00-\x1f\x7f-\x9f]*$")]
_Place = Annotated[float, Field(ge=-100, le=100)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


class NoArgs(_Strict):
    """Nothing."""


class RuleArgs(_Strict):
    """The rule that a request concerns, and who wants it."""

    rule: _Name = ""
    """The rule; empty for every rule that it applies to."""
    by: _Name = ""
    """Who wants it."""
    why: _Words = ""
    """Why."""


class ShelveArgs(RuleArgs):
    """The way to shelve a rule."""

    for_s: Annotated[float, Field(gt=0, le=MAX_DURATION_S, strict=False)] | None = None
    """For how long; None for as long as the rule allows."""
    one_shot: bool = False
    """Until the alarm has returned to normal, or the time is over."""


class KeyArgs(RuleArgs):
    """A threshold of a rule."""

    key: _Name = ""
    """Its name, such as ``below``; empty for the only one, or to withdraw every one."""


def _parse_value(value: object) -> tuple[float, str]:
    """Read a number in the SI unit, or a text with a unit; return it in the SI unit, and that unit if it was given."""
    if isinstance(value, str) and len(value) <= VALUE_MAX_LENGTH:
        return parse_any_quantity(value)
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= MAX_PLAIN:  # nor NaN
        raise ValueError("write a number in the SI unit, or a text with a unit, such as '60 cm'")
    return float(value), ""


class SetThresholdArgs(KeyArgs):
    """A threshold of a rule, and its value."""

    rule: Annotated[_Name, Field(min_length=1)]
    value: Annotated[tuple[float, str], PlainValidator(_parse_value)]
    """As it is written: a number in the SI unit, or a text with a unit."""


class OutputsArgs(_Strict):
    """The one who wants every output stopped or released, or the run armed or disarmed, and why."""

    by: _Name = ""
    why: _Words = ""


class ExplainArgs(_Strict):
    """The subject to explain."""

    rule: _Name = ""
    """The rule; empty for each."""
    at_unix_s: Annotated[float, Field(ge=-MAX_TIME_S, le=MAX_TIME_S, strict=False)] | None = None
    """The moment, in seconds since 1970 on the wall clock; None for now."""
    ago_s: Annotated[float, Field(ge=0, le=MAX_DURATION_S, strict=False)] | None = None
    """In place of that: how long ago it was."""


class HoldArgs(_Strict):
    """An output to hold for a moment, and how. `app` and `core` know which output takes what."""

    output: _Name
    level: float | None = None
    linear_mps: float | None = None
    angular_radps: float | None = None
    is_release: Annotated[bool, Field(alias="release")] = False
    """Let go of it."""
    by: _Name = ""


class RecordArgs(_Strict):
    """Begin or end a recording."""

    do: Literal["start", "stop"]


class WorldArgs(_Strict):
    """An event to cause in a simulated world: its target is put somewhere, let go of, or something goes wrong."""

    target: _Name = ""
    """Its name in the configuration; empty for the only one."""
    x_m: _Place | None = None
    y_m: _Place | None = None
    bearing_rad: float | None = None
    """As the camera sees it, positive to the right; with `distance_m`."""
    distance_m: Annotated[float, Field(gt=0, le=100, strict=False)] | None = None
    release: bool = False
    """Let the target go on along its path."""
    fault: _Name = ""
    """Make this go wrong, or put it right again."""


class SubscribeArgs(_Strict):
    """The data that a watcher of a run receives, and how often."""

    rate_hz: Annotated[float, Field(gt=0, le=10, strict=False)] = 10.0
    """How many snapshots a second, at most."""
    image: Literal["none", "plain", "drawn"] = "none"
    """Whether the frame comes with it as JPEG, and whether what was found is drawn in."""
    quality: Annotated[int, Field(ge=10, le=95)] = 80
    """Quality of the JPEG."""


class FrameArgs(_Strict):
    """In which form the newest frame is wanted."""

    encoding: Literal["jpeg", "raw"] = "jpeg"
    """As JPEG, or row by row, each pixel three bytes, blue first."""
    image: Literal["plain", "drawn"] = "plain"
    """Whether what was found is drawn in."""
    quality: Annotated[int, Field(ge=10, le=95)] = 80
    """Quality of the JPEG."""


_BY_TAKES: Mapping[tuple[Takes, ...], type[RuleArgs]] = {
    (): RuleArgs,
    ("for_s", "one_shot"): ShelveArgs,
    ("key",): KeyArgs,
    ("key", "value"): SetThresholdArgs,
}

# The operations that may be asked for, each with its arguments.
ARGS: Mapping[str, type[_Strict]] = {
    **{action.command: OutputsArgs if action.is_on_outputs else _BY_TAKES[action.takes] for action in OperatorAction},
    "hold-output": HoldArgs,
    "explain": ExplainArgs,
    **dict.fromkeys(("hello", "status", "alarms", "metrics", "reload", "restart"), NoArgs),
    "record": RecordArgs,
    "world": WorldArgs,
    "subscribe": SubscribeArgs,
    "frame": FrameArgs,
}

ACTIONS = {action.command: action for action in OperatorAction}

Transaction = str | int | None


_Transaction = Annotated[str, StringConstraints(max_length=200)] | int | None


class _Envelope(_Strict):
    transaction: _Transaction = None
    op: str
    args: dict[str, Any] = Field(default_factory=dict)


class Request(Struct, frozen=True):
    """A request that is sound.

    Attributes:
        op: A key of `ARGS`; `args` is an instance of its value.
    """

    op: str
    args: Any
    transaction: Transaction = None

    @property
    def is_command(self) -> bool:
        """True if it becomes an operator's command to the core."""
        return self.op in ACTIONS or self.op == "hold-output"


# What follows the line of an answer; a view of bytes that others hold is not copied.
Attached = bytes | memoryview


class Reply(Struct, frozen=True):
    """An answer: what was asked for, or why it is not done.

    Attributes:
        problems: Those of a configuration that is wrong.
        attached: Bytes that follow the line, such as a picture.
    """

    data: Any = None
    error: str = ""
    problems: tuple[Problem, ...] = ()
    attached: Attached = b""

    def line(self, transaction: Transaction) -> bytes:
        """Return one line, in ASCII: text from outside may hold what UTF-8 cannot, such as half of a surrogate pair."""
        answer: dict[str, Any] = {"transaction": transaction, "status": "error" if self.error else "ok"}
        answer |= {"problems": [plain(problem) for problem in self.problems]} if self.problems else {}
        answer |= {"error": self.error} if self.error else {"data": self.data}
        return encode_line(answer, len(self.attached))


def parse_request(line: bytes) -> Request:
    """Read a request; `ControlError` says what is wrong with it."""
    try:
        envelope = _Envelope.model_validate_json(line)
    except ValidationError as error:
        raise ControlError(_what_is_wrong(error)) from error
    kind = ARGS.get(envelope.op)
    if kind is None:
        raise ControlError(_UNKNOWN_OP)
    try:
        return Request(envelope.op, kind.model_validate(envelope.args), envelope.transaction)
    except ValidationError as error:
        raise ControlError(_what_is_wrong(error, "args")) from error


def parse_flat_request(op: str, payload: bytes, asker: str) -> Request:
    """Read a request whose operation is known, so that its arguments and its transaction stand side by side.

    Args:
        asker: By which way it came, such as ``mqtt``; the name of who asks is put behind it.

    Raises:
        ControlError: It is wrong; the message says where.
    """
    try:
        found = _flat_model(op).model_validate_json(payload)
    except ValidationError as error:
        raise ControlError(_what_is_wrong(error, example="{}")) from error
    values = {name: getattr(found, name) for name in ARGS[op].model_fields}
    if "by" in values:
        values["by"] = f"{asker} ({values['by']})" if values["by"] else asker
    return Request(op, ARGS[op].model_construct(**values), getattr(found, "transaction"))  # noqa: B009 - made at run time


@cache
def _flat_model(op: str) -> type[_Strict]:
    return create_model(f"Flat{ARGS[op].__name__}", __base__=ARGS[op], transaction=(_Transaction, None))


def transaction_of(line: bytes) -> Transaction:
    """Return the transaction of a request that may be wrong otherwise, if there is one."""
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return None
    transaction = found.get("transaction") if isinstance(found, dict) else None
    is_usable = isinstance(transaction, str | int) and len(str(transaction)) <= 200
    return transaction if is_usable else None


def operator_command(request: Request, number: str) -> AnyCommand:
    """Return the command that an operator gives to a rule or an output, as the core sees it."""
    args = vars(request.args)  # flat values only: a copy of them takes longer than all the rest
    if isinstance(request.args, HoldArgs):
        return HoldCommand(id=number, **args)
    if isinstance(request.args, SetThresholdArgs):
        args = {**args, **dict(zip(("value", "unit"), request.args.value, strict=True))}
    return OperatorCommand(id=number, action=ACTIONS[request.op], **args)


_UNKNOWN_OP = f'"op" must be one of: {", ".join(ARGS)}'


def _what_is_wrong(error: ValidationError, *within: str, example: str = '{"op": "status"}') -> str:
    detail = error.errors(include_url=False, include_input=False)[0]
    if detail["type"] == "json_invalid":
        return f"this is not JSON: {detail['ctx']['error']}"
    if not within and detail["loc"] == ("op",):
        return _UNKNOWN_OP
    place = ".".join(map(str, (*within, *detail["loc"])))
    if not place:
        return f"a request is a JSON object, such as {example}"
    if detail["type"] == "string_pattern_mismatch":
        return f"{place}: write one line of text, without control characters"
    if detail["type"] == "value_error":
        return f"{place}: {detail['ctx']['error']}"
    return f"{place}: {detail['msg'][:1].lower()}{detail['msg'][1:]}"


def as_data(explanation: Explanation) -> dict[str, Any]:
    """Return an explanation as JSON has it: objects, lists, texts, finite numbers and null only."""
    data: dict[str, Any] = json.loads(msgspec.json.encode(plain(explanation)))  # infinity and NaN become null
    return data
