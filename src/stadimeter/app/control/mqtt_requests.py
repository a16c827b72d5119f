"""Requests that other programs send as messages: the same as at the control socket, save what moves something.

The messenger's thread reads them. The control loop takes those that are sound, once a cycle, and answers; what takes
long to put into words is answered by a thread of its own. Others never reach it, however many come.
"""

from __future__ import annotations

import json
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from stadimeter.app.control.messages import FrameArgs, Reply, Request, Transaction, parse_flat_request, transaction_of
from stadimeter.app.control.socket_server import Asked, make_reply
from stadimeter.core.message import REQUEST, RESPONSE, SNAPSHOT
from stadimeter.errors import ControlError
from stadimeter.messaging.protocol import RequestMessage, TakesRequests
from stadimeter.operator_actions import SWITCHES, OperatorAction

# This many requests of a topic may be under way. More are counted, and not answered.
WAITING_MAX = 16

# A request that the loop takes later than this is not done: who sent it may have given up, or sent another since.
AGE_MAX_S = 5.0

RESPONSE_MAX_BYTES = 64 * 1024
PICTURE_MAX_BYTES = 1024 * 1024


# By what is asked for: the operation of the control socket, and whether the configuration must say so, whatever its
# rules are: it lets all outputs act, takes a picture or writes a file. What an order to a rule could do is judged by
# the loop, which knows the rules. What is not here cannot be asked for: to hold an output or change a simulated world
# moves something, and a restart ends the connection that the answer would need.
OFFERS: Mapping[str, tuple[str, bool]] = {
    **{action.value: (action.command, action.lets_outputs_act or action.writes_file) for action in OperatorAction},
    **{op: (op, False) for op in ("status", "alarms", "explain")},
    **{op: (op, True) for op in ("record", "reload")},
    SNAPSHOT.path: ("frame", True),
    **{switch: (off.command, False) for switch, (_, off) in SWITCHES.items()},
}

_WORDS = {
    "retained": "a command that is kept by the broker (retain) is not done: it would come again with each connection",
    "stale": "this came while the program was not connected or too busy, so it is not done; send it again",
    "too_large": "a request has 4096 bytes at most",
}


class MqttRequests:
    """Takes requests from a messenger.

    Args:
        take_picture: Returns the newest frame.
        tell: Takes a line for people. Called in the loop.
        clock: A monotonic clock, that of the messages.
    """

    def __init__(
        self,
        messenger: TakesRequests,
        take_picture: Callable[[FrameArgs], Reply],
        tell: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._messenger = messenger
        self._take_picture = take_picture
        self._tell = tell
        self._clock = clock
        self._asked: deque[tuple[float, Asked]] = deque()
        self._warnings: dict[str, str] = {}
        self._warned = 0
        self._lock = threading.Lock()  # of what follows
        self._waiting: Counter[str] = Counter()
        self._done = 0
        self._refused: Counter[str] = Counter()

    def open(self) -> None:
        """Begin to listen; the messenger must not be open yet."""
        may_all = self._messenger.commands == "all"
        offered = [REQUEST.of(name) for name, (_, needs_all) in OFFERS.items() if may_all or not needs_all]
        self._messenger.listen(list(map(REQUEST.of, OFFERS)), offered, self.receive)

    def take(self) -> list[Asked]:
        """Return the requests that have come since the last call, oldest first. Never waits."""
        if self._warned < len(self._warnings):
            self._tell(f"warning: {list(self._warnings.values())[self._warned]}")
            self._warned += 1
        taken = []
        while self._asked:
            at_s, asked = self._asked.popleft()
            if self._clock() - at_s <= AGE_MAX_S:
                taken.append(asked)
            else:
                asked.answer(_TooLate(error=_WORDS["stale"]))
        return taken

    def figures(self) -> Mapping[str, Any]:
        """Return the requests that may be made, and what came of those that were. From any thread."""
        with self._lock:
            done, refused = self._done, dict(self._refused)
        trouble = self._messenger.deafness()
        return {"allowed": self._messenger.commands, "done": done, "refused": refused, "trouble": trouble}

    def receive(self, message: RequestMessage) -> None:
        """Take in a message. Called in the messenger's thread; it neither waits nor fails."""
        with self._lock:
            if self._waiting[message.topic] >= WAITING_MAX:
                self._refused["too_many"] += 1
                return
            self._waiting[message.topic] += 1
        try:
            self._read(message)
        except Exception as error:  # noqa: BLE001 - a defect costs one command its answer, and not all that follow
            self._warn("defect", f"a command over MQTT was not answered: {type(error).__name__}: {error}")
            with self._lock:
                self._waiting[message.topic] -= 1

    def _warn(self, kind: str, words: str) -> None:
        """Have the loop say something, the first time only."""
        self._warnings.setdefault(kind, words)

    def _read(self, message: RequestMessage) -> None:
        """Refuse a message, or let the loop have it."""
        name = message.topic.partition("/")[2]
        op, needs_all = OFFERS[name]
        transaction = transaction_of(message.payload)
        may_all = self._messenger.commands == "all"
        if message.refusal == "retained":
            self._warn("retained", f"{message.topic}: {_WORDS['retained']}; have its sender send it without retain")
        if message.refusal is not None:
            self._respond(message, transaction, Reply(error=_WORDS[message.refusal]), message.refusal)
            return
        if needs_all and not may_all:
            words = f"'{name}' is not allowed over MQTT: it needs commands = \"all\" in [messenger]"
            self._respond(message, transaction, Reply(error=words), "not_allowed")
            return
        try:
            request = parse_flat_request(*(_switched(message) or (op, message.payload)), "mqtt")
        except ControlError as error:
            self._respond(message, transaction, Reply(error=str(error)), "invalid")
            return
        answer = partial(self._answer, message, transaction)
        if op == "frame":
            answer(partial(self._show_picture, request))
        else:
            self._asked.append((message.at_s, Asked(request, answer, may_let_act=may_all)))

    def _answer(self, message: RequestMessage, transaction: Transaction, reply: Reply | Callable[[], Reply]) -> None:
        """Answer, in any thread; what must be made first is made in one of its own."""
        if isinstance(reply, Reply):
            self._respond(message, transaction, reply)
        else:
            made = lambda: self._respond(message, transaction, make_reply(reply))  # noqa: E731
            threading.Thread(target=made, name="mqtt answer", daemon=True).start()

    def _respond(
        self, message: RequestMessage, transaction: Transaction, reply: Reply, why: str = "by_the_run"
    ) -> None:
        try:
            line = reply.line(transaction).rstrip()
        except (TypeError, ValueError) as error:  # a number that JSON has not
            reply = Reply(error=f"the answer could not be put into words: {error}")
            line = reply.line(transaction).rstrip()
        if len(line) > RESPONSE_MAX_BYTES:
            reply = Reply(error="the answer is too large for a message; name a rule")
            line = reply.line(transaction).rstrip()
        with self._lock:
            self._waiting[message.topic] -= 1
            self._done += not reply.error
            if reply.error:
                self._refused["stale" if isinstance(reply, _TooLate) else why] += 1
        self._messenger.respond(message, RESPONSE.of(message.topic.partition("/")[2]), line)

    def _show_picture(self, request: Request) -> Reply:
        """Send the newest frame to its topic."""
        if request.args.encoding != "jpeg":
            return Reply(error='encoding: over MQTT a picture is "jpeg"')
        reply = self._take_picture(request.args)
        if reply.error:
            return reply
        size = len(reply.attached)
        if size > PICTURE_MAX_BYTES:
            return Reply(error=f"the picture has {size} bytes, more than {PICTURE_MAX_BYTES}; lower its quality")
        if not self._messenger.show(SNAPSHOT.path, bytes(reply.attached), "image/jpeg"):
            return Reply(error=f"the broker does not take a picture of {size} bytes now")
        return Reply({"topic": SNAPSHOT.path, "bytes": size, **reply.data})


def _switched(message: RequestMessage) -> tuple[str, bytes] | None:
    """Return the operation that a switch asks for, and its arguments; None for a topic that is no switch's."""
    actions = SWITCHES.get(message.topic.partition("/")[2])
    if actions is None:
        return None
    try:
        found = json.loads(message.payload)
        value = found.pop("value")
    except (ValueError, RecursionError, AttributeError, LookupError, TypeError):
        value = None
    if not isinstance(value, bool):
        raise ControlError('this must be a JSON object such as {"rule": "near", "value": true}')
    return actions[not value].command, json.dumps(found).encode()


class _TooLate(Reply, frozen=True):
    """Says that a request waited for too long."""
