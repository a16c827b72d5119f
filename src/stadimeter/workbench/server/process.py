"""The process: reads requests as lines, answers each in order, and outlives whatever goes wrong in one."""

from __future__ import annotations

import json
import select
import sys
import traceback
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, BinaryIO

from stadimeter.app.control.framing import framed
from stadimeter.errors import ConfigError, Problem, StadimeterError
from stadimeter.workbench.server.operations import Desk, find_operation

# A configuration within JSON, with room for one that is much too long; a longer line is passed over.
REQUEST_MAX_BYTES = 4 * 1024 * 1024

# If nothing was asked for this long, a camera is not held any longer.
REST_AFTER_S = 60.0

CHUNK_BYTES = 65536


def serve(desk: Desk, requests: BinaryIO, answers: BinaryIO, rest_after_s: float = REST_AFTER_S) -> None:
    """Answer requests until there are no more, or the reader of the answers is gone.

    Args:
        requests: Not buffered, so that it can be waited for.
    """
    try:
        for line in _lines(desk, requests, rest_after_s):
            answers.write(_answer_request(desk, line))
            answers.flush()
    except BrokenPipeError:
        pass
    finally:
        _rest(desk)


def _rest(desk: Desk) -> None:
    for each in desk.at_rest:
        with suppress(StadimeterError):
            each()


def _lines(desk: Desk, requests: BinaryIO, rest_after_s: float) -> Iterator[bytes]:
    """Yield each line; one that is too long as nothing but its beginning."""
    line, is_resting = bytearray(), False
    while True:
        if not is_resting and not select.select([requests], [], [], rest_after_s)[0]:
            _rest(desk)
            is_resting = True
        data = requests.read(CHUNK_BYTES)
        if not data:
            return
        is_resting = False
        first, *others = data.split(b"\n")
        line += first[: max(0, REQUEST_MAX_BYTES + 1 - len(line))]
        for other in others:
            yield bytes(line)
            line = bytearray(other)


def _answer_request(desk: Desk, line: bytes) -> bytes:
    """Return the answer to a request, as it is sent."""
    transaction: Any = None
    try:
        transaction, name, args = _request(line)
        reply = find_operation(name)(desk, args)
        return framed({"transaction": transaction, "status": "ok", "data": reply.data}, reply.attached)
    except StadimeterError as error:
        return framed({"transaction": transaction, **error_fields(error)})
    except BaseException as error:  # noqa: BLE001 - a defect in one operation must not end the others
        traceback.print_exc(file=sys.stderr)
        words = f"this is a defect of stadimeter, not of yours: {type(error).__name__}: {error}"
        return framed({"transaction": transaction, "status": "error", "error": words, "code": "defect"})


def _request(line: bytes) -> tuple[Any, str, dict[str, Any]]:
    if len(line) > REQUEST_MAX_BYTES:
        raise ConfigError(f"a request is longer than {REQUEST_MAX_BYTES} bytes")
    try:
        request = json.loads(line)
        transaction, name, args = request.get("transaction"), request["op"], request.get("args") or {}
    except (ValueError, KeyError, AttributeError, RecursionError) as error:
        raise ConfigError('a request is an object of JSON such as {"op": "editing.check", "args": {}}') from error
    if not isinstance(name, str) or not isinstance(args, dict):
        raise ConfigError("op is the name of an operation, and args an object")
    return transaction, name, args


def error_fields(error: StadimeterError) -> dict[str, Any]:
    """Return an error as an answer has it."""
    answer: dict[str, Any] = {"status": "error", "error": str(error)}
    code = getattr(error, "code", "")
    problems = getattr(error, "problems", ())
    data = getattr(error, "data", None)
    return {
        **answer,
        **({"code": code} if code else {}),
        **({"data": data} if data else {}),
        **({"problems": [as_json(each) for each in problems]} if problems else {}),
    }


def as_json(problem: Problem) -> dict[str, Any]:
    """Return a problem as an answer has it."""
    keys = ("message", "file", "line", "column", "end_column", "key", "hint", "code")
    return {key: getattr(problem, key) for key in keys}
