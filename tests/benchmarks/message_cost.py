"""What a message costs the thread that publishes it: ``python tests/benchmarks/message_cost.py``, from the checkout.

Time that passes in `publish`, with a real mosquitto and without one: back to back, and with the pauses of a control
loop, in which caches go cold and the link's thread falls asleep. States of targets and events of alarms take turns.
Delivery is until a subscriber of the same broker has an event.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from stadimeter.core.message import Message
from stadimeter.messaging.mqtt import MqttOptions, PahoMessenger
from stadimeter.testing.rig import eventually
from support.broker import BrokerAccess, MosquittoBroker, free_port
from support.mqtt_listener import MqttListener

STATE = '{"v":1,"seq":%d,"status":"tracking","distance_m":1.482,"sigma_m":0.021,"closing_mps":0.35,"bearing_rad":-0.1}'
EVENT = '{"v":1,"id":"6f1c2d0e9b7a4c35a1d2e3f405162738-%d","event_type":"raised","rule":"near","severity":"alarm"}'


def message(number: int) -> Message:
    """Return a state of a target, or an event of an alarm."""
    if number % 2:
        return Message(topic="event/alarm", payload=EVENT % number, qos=1, at_s=time.monotonic())
    return Message(topic="target/ball/state", payload=STATE % number, retain=True, expires_s=10)


def row(costs_s: Iterable[float], unit_s: float) -> dict[str, float]:
    """Return median, 99th percentile and largest."""
    ordered = sorted(costs_s)
    at = {"median": len(ordered) // 2, "p99": len(ordered) * 99 // 100, "max": -1}
    return {name: round(ordered[index] / unit_s, 1) for name, index in at.items()}


def publish_all(messenger: PahoMessenger, count: int, pause_s: float) -> tuple[list[float], list[float]]:
    """Publish; return when each call began, and how long it took."""
    began_s, costs_s = [], []
    for number in range(count):
        sent = message(number)
        time.sleep(pause_s)
        began_s.append(time.perf_counter())
        messenger.publish(sent)
        costs_s.append(time.perf_counter() - began_s[-1])
    return began_s, costs_s


def delivery_ms(messenger: PahoMessenger, count: int, pause_s: float, port: int) -> dict[str, float]:
    """Publish, and return how long it took until a subscriber in this program had each event."""
    with MqttListener(port) as listener:
        began_s, _ = publish_all(messenger, count, pause_s)
        eventually(lambda: not messenger.undelivered())
        listener.wait_for("stadimeter/cost/event/alarm", EVENT % (count - 1))
        came_s = {each.payload: each.at_s for each in listener.heard}
    return row([came_s[EVENT % number] - began_s[number] for number in range(1, count, 2)], 1e-3)


def main() -> None:
    """Print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000, help="how many messages in each row")
    parser.add_argument("--pause-ms", type=float, default=20.0, help="between messages, in the row with pauses")
    options = parser.parse_args()
    found: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        broker = MosquittoBroker(Path(folder), BrokerAccess())
        broker.start()
        try:
            for where, port in (("connected", broker.port), ("away", free_port())):
                for how, pause_s in (("pauses", options.pause_ms / 1000), ("hot", 0.0)):
                    messenger = PahoMessenger(MqttOptions(port=port, node="cost", home_assistant=False))
                    messenger.open()
                    if where == "connected":
                        eventually(lambda each=messenger: not each.trouble())
                    _, costs_s = publish_all(messenger, options.count, pause_s)
                    found[f"{where}, {how}, us"] = row(costs_s, 1e-6)
                    if where == "connected" and pause_s:
                        found["delivery, ms"] = delivery_ms(messenger, options.count // 5 // 2 * 2, pause_s, port)
                    messenger.close()
        finally:
            broker.stop()
    sys.stdout.write(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
