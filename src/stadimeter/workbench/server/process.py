"""The process, which the page starts: it answers requests in order, and outlives whatever goes wrong in one."""

from __future__ import annotations

import json
import os
import signal
import sys
import traceback
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from msgspec import to_builtins

from stadimeter.app.control.client import encode_answer
from stadimeter.errors import ConfigError, StadimeterError
from stadimeter.workbench.server.operations import Desk, find_operation


def serve(desk: Desk, requests: BinaryIO, answers: BinaryIO) -> None:
    """Answer requests until there are no more, or the reader of the answers is gone."""
    try:
        for line in requests:
            answers.write(_answer_request(desk, line))
            answers.flush()
    except BrokenPipeError:
        pass
    finally:
        for each in desk.at_end:
            with suppress(StadimeterError):
                each()


def _answer_request(desk: Desk, line: bytes) -> bytes:
    transaction: Any = None
    try:
        transaction, name, args = _request(line)
        reply = find_operation(name)(desk, args)
        return encode_answer({"transaction": transaction, "status": "ok", "data": reply.data}, reply.attached)
    except StadimeterError as error:
        return encode_answer({"transaction": transaction, **error_fields(error)})
    except BaseException as error:  # noqa: BLE001 - a defect in one operation must not end the others
        traceback.print_exc(file=sys.stderr)
        words = f"this is a defect of stadimeter, not of yours: {type(error).__name__}: {error}"
        return encode_answer({"transaction": transaction, "status": "error", "error": words, "code": "defect"})


def _request(line: bytes) -> tuple[Any, str, dict[str, Any]]:
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
    more = {key: to_builtins(value) for key in ("code", "problems") if (value := getattr(error, key, None))}
    return {"status": "error", "error": str(error), **more}


def main(configuration: str, *socket: str) -> None:
    """Answer on a copy of standard output: what a library prints must not get between the answers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the page, which ends this by closing the pipe
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    desk = Desk(configuration=Path(configuration).resolve(), run_socket=Path(*socket) if socket else None)
    with os.fdopen(os.dup(sys.stdin.fileno()), "rb") as requests:
        serve(desk, requests, answers)


if __name__ == "__main__":
    main(*sys.argv[1:])
