"""Requests that other programs send as messages: the same as at the control socket, save what moves something.

A thread of its own reads them, and puts answers into words. The control loop takes those that are sound, once a cycle,
and hands back what became of them. Others never reach it, however many come.
"""

from __future__ import annotations

import json
import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from msgspec import Struct

from stadimeter.app.control.messages import FrameArgs, Reply, Request, Transaction, parse_flat_request, transaction_of
from stadimeter.app.control.socket_server import Asked, make_reply
from stadimeter.core.message import REQUEST, RESPONSE, SNAPSHOT
from stadimeter.errors import ControlError
from stadimeter.messaging.protocol import RequestMessage, TakesRequests
from stadimeter.operator_actions import SWITCHES, OperatorAction

# This many requests of a topic may be under way.
WAITING_MAX = 16

# A request that the loop takes later than this is not done: who sent it may have given up, or sent another since.
AGE_MAX_S = 5.0

# A sender of too many messages hears so this often; to answer each would cost as much as to do it.
TOO_MANY_EVERY_S = 1.0

RESPONSE_MAX_BYTES = 64 * 1024
PICTURE_MAX_BYTES = 1024 * 1024


class _Offer(Struct, frozen=True):
    """A request that may be made by messages.

    Attributes:
        op: The operation of the control socket that it is.
        needs_all: Whether the configuration must say so, whatever its rules are: it lets all outputs act, takes a
            picture or writes a file. What an order to a rule could do is judged by the loop, which knows the rules.
    """

    op: str
    needs_all: bool = False


# What is not here cannot be asked for: to hold an output or change a simulated world moves something, and a restart
# ends the connection that the answer would need.
OFFERS: Mapping[str, _Offer] = {
    **{
        action.value: _Offer(action.command, action.lets_outputs_act or action.writes_file) for action in OperatorAction
    },
    **{op: _Offer(op) for op in ("status", "alarms", "explain", "calibrate")},
    **{op: _Offer(op, needs_all=True) for op in ("record", "reload")},
    SNAPSHOT.path: _Offer("frame", needs_all=True),
    **{switch: _Offer(off.command) for switch, (_, off) in SWITCHES.items()},
}

_WORDS = {
    "retained": "a command that is kept by the broker (retain) is not done: it would come again with each connection",
    "stale": "this came while the program was not connected or too busy, so it is not done; send it again",
    "too_many": "too many commands came at once; wait a moment",
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
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._asked: deque[tuple[float, Asked]] = deque()
        self._thread = threading.Thread(target=self._run, name="mqtt requests", daemon=True)
        self._warnings: dict[str, str] = {}
        self._warned = 0

        # Written in the messenger's thread only.
        self._received: Counter[str] = Counter()
        self._overflowed = 0
        self._complained_s = float("-inf")
        # Written in our thread only.
        self._finished: Counter[str] = Counter()
        self._done = 0
        self._refused: Counter[str] = Counter()

    def open(self) -> None:
        """Begin to listen; the messenger must not be open yet."""
        may_all = self._messenger.commands == "all"
        offered = [REQUEST.of(name) for name, offer in OFFERS.items() if may_all or not offer.needs_all]
        self._messenger.listen(list(map(REQUEST.of, OFFERS)), offered, self.receive)
        self._thread.start()

    def close(self) -> None:
        """End. What was not answered stays so. May be called again."""
        self._jobs.put(None)

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
        refused = dict(self._refused)
        if self._overflowed:
            refused["too_many"] = refused.get("too_many", 0) + self._overflowed
        return {
            "allowed": self._messenger.commands,
            "done": self._done,
            "refused": refused,
            "trouble": self._messenger.deafness(),
        }

    def receive(self, message: RequestMessage) -> None:
        """Take in a message. Called in the messenger's thread; it neither waits nor fails."""
        waiting = self._received[message.topic] - self._finished[message.topic]
        if message.refusal == "too_many" or waiting >= WAITING_MAX:
            if message.at_s - self._complained_s < TOO_MANY_EVERY_S:
                self._overflowed += 1
                return
            self._complained_s = message.at_s
            self._jobs.put(partial(self._refuse, message, None, "too_many", _WORDS["too_many"]))
        else:
            self._jobs.put(partial(self._read, message))
        self._received[message.topic] += 1

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                job()
            except Exception as error:  # noqa: BLE001 - a defect costs one command its answer, and not all that follow
                self._warn("defect", f"a command over MQTT was not answered: {type(error).__name__}: {error}")

    def _warn(self, kind: str, words: str) -> None:
        """Have the loop say something, the first time only."""
        self._warnings.setdefault(kind, words)

    def _read(self, message: RequestMessage) -> None:
        """Refuse a message, or let the loop have it."""
        name = message.topic.partition("/")[2]
        offer = OFFERS[name]
        transaction = transaction_of(message.payload)
        if message.refusal == "retained":
            self._warn("retained", f"{message.topic}: {_WORDS['retained']}; have its sender send it without retain")
        if message.refusal is not None:
            self._refuse(message, transaction, message.refusal, _WORDS[message.refusal])
        elif offer.needs_all and self._messenger.commands != "all":
            words = f"'{name}' is not allowed over MQTT: it needs commands = \"all\" in [messenger]"
            self._refuse(message, transaction, "not_allowed", words)
        else:
            self._hand_over(message, offer, transaction)

    def _hand_over(self, message: RequestMessage, offer: _Offer, transaction: Transaction) -> None:
        try:
            op, payload = _switched(message) or (offer.op, message.payload)
            request = parse_flat_request(op, payload, "mqtt")
        except ControlError as error:
            self._refuse(message, transaction, "invalid", str(error))
            return
        if offer.op == "frame":
            self._answer(message, transaction, partial(self._show_picture, request))
        else:
            answer = partial(self._hand_back, message, transaction)
            may_let_act = self._messenger.commands == "all"
            self._asked.append((message.at_s, Asked(request, answer, may_let_act)))

    def _hand_back(self, message: RequestMessage, transaction: Transaction, reply: Reply | Callable[[], Reply]) -> None:
        """Take an answer, in any thread, and let ours put it into words."""
        self._jobs.put(partial(self._answer, message, transaction, reply))

    def _answer(self, message: RequestMessage, transaction: Transaction, reply: Reply | Callable[[], Reply]) -> None:
        known = reply if isinstance(reply, Reply) else make_reply(reply)
        if known.error:
            self._refuse(message, transaction, "stale" if isinstance(known, _TooLate) else "by_the_run", known.error)
            return
        try:
            line = known.line(transaction).rstrip()
        except ValueError as error:  # a number that JSON has not
            self._refuse(message, transaction, "by_the_run", f"the answer could not be put into words: {error}")
            return
        if len(line) > RESPONSE_MAX_BYTES:
            self._refuse(message, transaction, "by_the_run", "the answer is too large for a message; name a rule")
            return
        self._done += 1
        self._respond(message, line)

    def _refuse(self, message: RequestMessage, transaction: Transaction, why: str, words: str) -> None:
        self._refused[why] += 1
        self._respond(message, Reply(error=words).line(transaction).rstrip())

    def _respond(self, message: RequestMessage, line: bytes) -> None:
        self._finished[message.topic] += 1
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
