"""What a command over MQTT costs the control loop: ``python tests/benchmarks/command_cost.py``, from the checkout.

It times what the loop does in a cycle with a command, and in one without: it takes the command, hands it to the core
and gives its answer back. Another thread reads the message and puts the answer into words. Processor time of the loop's
thread by default; ``--wall`` adds what that thread waits for, such as other programs on a busy computer.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Collection
from pathlib import Path

from msgspec.structs import replace

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from stadimeter.app.bootstrap import demo_configuration
from stadimeter.app.control.messages import Reply
from stadimeter.app.control.mqtt_requests import MqttRequests
from stadimeter.app.control.reloading import Reloader
from stadimeter.app.control.requests import Control
from stadimeter.core.operator import OperatorAnswer
from stadimeter.messaging.protocol import CommandLevel, RequestMessage
from support.cycle_records import cycle_record

PAYLOAD = b'{"rule": "near", "by": "zoe", "why": "seen", "transaction": "7"}'


class NoMessenger:
    """A messenger that sends nothing."""

    commands: CommandLevel = "alarms"

    def listen(
        self, topics: Collection[str], offered: Collection[str], receive: Callable[[RequestMessage], None]
    ) -> None:
        """Pass over what to listen to: the messages are made here."""

    def respond(self, request: RequestMessage, topic: str, payload: bytes) -> None:
        """Pass over a response."""

    def show(self, topic: str, payload: bytes, content_type: str) -> bool:
        """Refuse a picture."""
        return False

    def deafness(self) -> str:
        """Return nothing that is wrong."""
        return ""


def measure(count: int, clock_ns: Callable[[], int]) -> dict[str, float]:
    """Return how long a cycle took with a command, and without, in µs."""
    requests = MqttRequests(NoMessenger(), lambda _args: Reply(), lambda _words: None)
    requests.open()
    control, record = Control(requests, Reloader(demo_configuration())), cycle_record()

    def cycle_us(*, has_command: bool) -> float:
        if has_command:
            requests.receive(RequestMessage(topic="request/acknowledge", payload=PAYLOAD, at_s=time.monotonic()))
        time.sleep(0.001)
        while has_command and not requests._asked:
            time.sleep(0.0005)
        began_ns = clock_ns()
        commands = control.operator_commands()
        between_ns = clock_ns()
        answers = tuple(OperatorAnswer(id=each.id, accepted=True, words="acknowledge: near") for each in commands)
        answered = replace(record, decision=replace(record.decision, answers=answers))
        again_ns = clock_ns()
        control.answer_requests(answered)
        return (between_ns - began_ns + clock_ns() - again_ns) / 1000

    for _ in range(200):
        cycle_us(has_command=True)
    without, with_command = (sorted(cycle_us(has_command=has) for _ in range(count)) for has in (False, True))
    requests.close()
    idle_us = without[count // 2]
    return {
        "median_us": round(with_command[count // 2] - idle_us, 1),
        "p99_us": round(with_command[count * 99 // 100] - idle_us, 1),
        "cycle_without_us": round(idle_us, 1),
    }


def main() -> None:
    """Print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=5000, help="how many commands")
    parser.add_argument("--wall", action="store_true", help="time that passes, in place of processor time")
    options = parser.parse_args()
    clock_ns = time.perf_counter_ns if options.wall else time.thread_time_ns
    sys.stdout.write(json.dumps(measure(options.count, clock_ns)) + "\n")


if __name__ == "__main__":
    main()
