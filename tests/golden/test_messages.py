"""Every message of three whole runs, and what Home Assistant discovers: their topics, in order, and their payloads."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from pathlib import Path
from typing import Any

from stadimeter.app.bootstrap import build
from stadimeter.app.loop import Limits, Loop
from stadimeter.app.messages import Reporter
from stadimeter.config.loader import load_configuration
from support.every_rule import EVERY_RULE, ORDERS, announced, every_rule
from support.golden import Golden, digest

DEMO = (Path(__file__).parents[2] / "config" / "demo.toml").read_text(encoding="utf-8").split("[[tests]]")[0]
GOLDEN = Path(__file__).with_name("rules.toml").read_text(encoding="utf-8")
STANDS = 'path = [{ at = "0 s", x = "2 m", y = "0 m" }]'
COMES_AND_GOES = """\
loop = false
path = [
  { at = "0 s", x = "2.5 m", y = "0.3 m" },
  { at = "3 s", x = "0.4 m", y = "0 m" },
  { at = "5 s", x = "0.4 m", y = "-0.1 m" },
  { at = "8 s", x = "3.5 m", y = "0 m" },
]
faults = [
  { at = "9 s", for = "2 s", kind = "hide-target" },
  { at = "12 s", for = "1 s", kind = "freeze-camera" },
]
"""
SERIAL_BASE = re.compile(r"\[base\]\n(.+\n)+")
"""The demonstration's base: its firmware answers on a real serial port, in the time of the computer."""
SIMULATED_BASE = '[base]\ndriver = "simulated"\nmax_speed = "0.5 m/s"\nacceleration = "0.5 m/s2"\n'
BALL_IN_PICTURES = (
    'detector = "ball"\ndiameter = "20 cm"    # the size that turns pixels into metres\nhsv = "29,86,6:64,255,255"'
)


def _stepped(demo: str) -> str:
    """Return the demonstration with neither pictures nor a port, so that it takes no time but the stepped clock's."""
    demo = demo.replace(BALL_IN_PICTURES, 'detector = "ideal"').replace('rate = "30 Hz"', "render = false")
    return SERIAL_BASE.sub(SIMULATED_BASE, demo)


CONFIGURATIONS = {
    "every rule": (EVERY_RULE.replace('driver = "mqtt"\nnode = "Dock-3"', 'driver = "simulated"'), 15.0),
    "demo": (_stepped(DEMO), 25.0),
    "golden rules": (GOLDEN, 14.0),
}
"""By their names, the text of each configuration and for how long it runs."""

WALL_CLOCK = re.compile(r"20\d\d-\d\d-\d\dT[0-9:.]+(Z|[+-]\d\d:\d\d)")
FIGURES_OF_THE_COMPUTER = "health"


def test_every_message_of_three_runs_is_what_it_was(golden: Golden, tmp_path: Path) -> None:
    rows = {}
    for name, (text, seconds) in CONFIGURATIONS.items():
        path = tmp_path / "run.toml"
        moving = text.replace(STANDS, COMES_AND_GOES)
        path.write_text(moving, encoding="utf-8")
        rows |= {f"{name}: {topic}": what for topic, what in _messages(path, seconds).items()}
    golden.compare("messages", rows)


def _messages(path: Path, seconds: float) -> dict[str, str]:
    """Return, by topic, how many messages a run sends and a digest of them; first their order."""
    loop = Loop(build(load_configuration(path), speed=None), reporter=Reporter("boot"))
    messenger: Any = loop.parts.messenger
    loop.run(Limits(seconds=seconds))
    sent, order = defaultdict(list), []
    for each in messenger.sent:
        message = each.item
        order.append(message.topic)
        payload = WALL_CLOCK.sub("a time", message.payload)
        if message.topic == FIGURES_OF_THE_COMPUTER:
            payload = ", ".join(json.loads(payload))
        sent[message.topic].append((each.at_s, payload, message.qos, message.retain, message.severity))
    assert messenger.given_up == 0
    return {"order": digest(order)} | {
        topic: f"{len(messages)} messages {digest(messages)}" for topic, messages in sorted(sent.items())
    }


def test_home_assistant_discovers_what_it_did(golden: Golden, tmp_path: Path) -> None:
    payload = json.loads(announced(every_rule(tmp_path), orders=ORDERS).message().payload)
    components = payload.pop("components")
    golden.compare("discovery", {"device": digest(payload)} | {key: digest(each) for key, each in components.items()})
