"""Orders over MQTT to a whole run: real broker, real processes."""

from __future__ import annotations

import json
import os
import random
import re
import shlex
import subprocess
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stadimeter.app.bootstrap import build
from stadimeter.app.control.messages import ARGS
from stadimeter.app.control.mqtt_requests import OFFERS
from stadimeter.app.loop import Loop
from stadimeter.cli.run_control import open_control_socket
from stadimeter.config.loader import load_configuration
from stadimeter.operator_actions import OperatorAction
from stadimeter.testing.rig import eventually
from stadimeter.workbench.replay import read_recording, replay_run
from support.broker import MosquittoBroker
from support.mqtt_listener import MqttAsker, MqttListener
from support.programs import needs
from support.simulated_run import SIMULATED_BALL

# A run in a thread of a test, that other programs command over MQTT.

ROOM = """
[rules.near]
actuator = "motor"
when = { below = "3 m" }
on_delay = "0 s"
ack = "required"
latch = true
shelve_max = "1 h"

[rules.guarded]
when = { below = "3 m" }
severity = "safety"

[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
loop = false
"""


class CommandedRun:
    """A run in a thread of this process, connected to a broker."""

    def __init__(self, folder: Path, port: int, closing: ExitStack, **options: str) -> None:
        self.path = folder / "room.toml"
        messenger = {"driver": "mqtt", "port": port, "node": "it", **options}
        table = "".join(f"{key} = {json.dumps(value)}\n" for key, value in messenger.items())
        self.path.write_text(f"{SIMULATED_BALL}{ROOM}\n[messenger]\n{table}")
        self.loop = Loop(build(load_configuration(self.path)))
        self.told: list[str] = []
        self.records: list[Any] = []
        self.loop.services.tell = self.told.append
        self.loop.listeners.append(lambda record, _frame: self.records.append(record))
        open_control_socket(self.loop, folder / "run.sock", closing)
        self._thread = threading.Thread(target=self.loop.run, daemon=True)
        closing.callback(self.end)
        self._thread.start()

    def end(self) -> None:
        """End, and wait for it."""
        self.loop.end("the test is over")
        self._thread.join(120)
        assert not self.is_alive

    @property
    def is_alive(self) -> bool:
        """Whether it has not ended."""
        return self._thread.is_alive()

    @property
    def commands(self) -> dict[str, Any]:
        """What `stadimeter status` says of commands over MQTT."""
        control = self.loop.services.control
        assert control is not None
        return dict(control.message_figures() or {})

    def given(self) -> list[tuple[str, str, str]]:
        """Return what operators commanded: the action, by whom, and why."""
        given = [command for record in self.records for command in record.observation.operator_commands]
        return [(str(each.action), each.by, each.why) for each in given]

    def level(self) -> float:
        """Return what the motor does in the newest cycle, from 0 to 1."""
        return float(self.records[-1].applied[0].level)


# Whole runs that other programs command over MQTT, through a real broker.

Start = Callable[..., tuple[CommandedRun, MqttAsker]]


@pytest.fixture
def broker(tmp_path: Path, closing: ExitStack) -> MosquittoBroker:
    broker = MosquittoBroker(tmp_path)
    broker.start()
    closing.callback(broker.stop)
    return broker


@pytest.fixture
def start(tmp_path: Path, broker: MosquittoBroker, closing: ExitStack) -> Start:
    """Return a function that starts a run, and gives it with a program that may ask it."""

    def start(*, is_v5: bool = True, **options: str) -> tuple[CommandedRun, MqttAsker]:
        asker = closing.enter_context(MqttAsker(broker.port, is_v5=is_v5))
        with MqttListener(broker.port) as witness:
            run = CommandedRun(tmp_path, broker.port, closing, **options)
            witness.wait_for("stadimeter/it/rule/near/state")
            witness.wait_for("stadimeter/it/availability", "online")
        assert isinstance(asker.ask("status"), dict)
        return run, asker

    return start


def test_every_row_of_the_table_of_actions_can_be_asked_for_and_nothing_that_moves_by_itself() -> None:
    assert {each.value for each in OperatorAction} < set(OFFERS)
    assert {"status", "alarms", "explain", "record", "reload", "snapshot"} < set(OFFERS)
    assert {op for op, _ in OFFERS.values()} <= set(ARGS)
    assert not {"hold-output", "world", "restart"} & {op for op, _ in OFFERS.values()}
    assert {name for name, (_, needs_all) in OFFERS.items() if needs_all} == {
        "arm", "clip", "confirm-mounting", "release-outputs", "record", "reload", "snapshot",
    }  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("protocol", ["5", "3.1.1"])
def test_every_action_is_done_and_answered_and_journaled_with_who_asked(protocol: str, start: Start) -> None:
    run, asker = start(commands="all", protocol=protocol, is_v5=protocol == "5")
    eventually(lambda: run.records and run.level() > 0)
    begun = asker.ask("record", do="start")
    assert asker.ask("acknowledge", rule="near", by="zoe", why="seen")["words"] == "acknowledge: near"
    assert "its condition still holds" in asker.ask("reset", rule="near")
    assert "words" in asker.ask("shelve", rule="near", for_s=600, one_shot=False, by="zoe")
    eventually(lambda: run.level() == 0)
    assert "words" in asker.ask("unshelve", rule="near")
    assert "words" in asker.ask("take-out", rule="near", why="painting")
    assert "words" in asker.ask("put-back", rule="near")
    assert "words" in asker.ask("observe", rule="near")
    eventually(lambda: run.level() == 0)
    assert "words" in asker.ask("act", rule="near")
    assert asker.ask("set-threshold", rule="near", value="60 cm")["words"] == "set-threshold: near"
    assert "words" in asker.ask("withdraw-threshold", rule="near")
    assert asker.ask("stop-outputs", by="zoe", why="a child")["unconfirmed"] == []
    eventually(lambda: run.level() == 0)
    assert "zoe" in asker.ask("release-outputs")["words"]
    eventually(lambda: run.level() > 0)
    assert "words" in asker.ask("disarm")
    eventually(lambda: run.level() == 0)
    assert "words" in asker.ask("arm")
    eventually(lambda: run.level() > 0)
    assert "add [black_box]" in asker.ask("clip")
    assert "mounting" in str(asker.ask("confirm-mounting"))
    assert asker.ask("explain", rule="near")["rules"][0]["rule"] == "near"
    assert [each["rule"] for each in asker.ask("alarms")["alarms"]]
    assert set(asker.ask("reload")["kept"]) == {"near", "guarded"}
    assert "cannot be shelved" in asker.ask("shelve", rule="guarded") or "safety" in asker.ask("shelve", rule="guarded")
    ended = asker.ask("record", do="stop")
    status = asker.ask("status")
    assert status["commands"]["refused"]["by_the_run"] >= 2
    assert status["commands"]["allowed"] == "all"

    given = run.given()
    assert ("acknowledge", "mqtt (zoe)", "seen") in given
    assert ("take-out", "mqtt", "painting") in given
    simple = {each.value for each in OperatorAction if not _is_tested_elsewhere(each)}
    assert {action for action, _, _ in given} >= simple
    recording = run.path.parent / "recordings" / begun["file"]
    assert ended["file"] == begun["file"]
    replayed = [
        (cycle.record().decision, decision) for cycle, _, decision in replay_run(read_recording(recording), None)
    ]
    assert len(replayed) > 20
    assert all(recorded == again for recorded, again in replayed)


def _is_tested_elsewhere(action: OperatorAction) -> bool:
    """Return whether an action needs more than a rule's name, so that its own tests have it."""
    return action.writes_file or ARGS[action.command].__name__ not in {"RuleArgs", "ShelveArgs", "OutputsArgs"}


def test_a_picture_comes_as_home_assistant_shows_it(start: Start) -> None:
    _, asker = start(commands="all")
    told = asker.ask("snapshot", quality=60)
    picture = asker.wait_for("stadimeter/it/snapshot")
    assert (told["topic"], told["bytes"]) == ("snapshot", len(picture.data))
    assert not picture.is_retained
    image = cv2.imdecode(np.frombuffer(picture.data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape[2] == 3
    assert 'over MQTT a picture is "jpeg"' in asker.ask("snapshot", encoding="raw")


def test_by_default_nothing_that_lets_outputs_act_is_done_and_a_stop_is(start: Start) -> None:
    run, asker = start()
    eventually(lambda: run.records and run.level() > 0)
    assert asker.ask("stop-outputs")["unconfirmed"] == []
    for action in ("release-outputs", "arm", "record", "reload", "snapshot"):
        assert f"'{action}' is not allowed over MQTT: it needs commands = \"all\"" in asker.ask(action)
    eventually(lambda: run.level() == 0)
    for action in ("reset", "unshelve", "put-back", "act", "withdraw-threshold", "set-threshold", "in-service"):
        more = {"in-service": {"value": True}, "set-threshold": {"value": "100 m"}}.get(action, {})
        assert "could let an output act, by near" in asker.ask(action, rule="near", **more)
    assert [action for action, _, _ in run.given()] == ["stop-outputs"]
    assert run.commands["refused"] == {"not_allowed": 5, "by_the_run": 7}


@pytest.mark.long
def test_whoever_asks_is_answered_where_they_listen(start: Start, broker: MosquittoBroker, closing: ExitStack) -> None:
    start()
    asker = closing.enter_context(MqttAsker(broker.port, also=("my/answers", "stadimeter/it/event/alarm")))
    asker.send("status", '{"transaction":1}', ResponseTopic="my/answers", CorrelationData=b"\x00\xff")
    answer = asker.wait_for("my/answers")
    assert (answer.correlation, answer.content_type) == (b"\x00\xff", "application/json")
    assert json.loads(answer.payload)["transaction"] == 1
    for number, topic in enumerate(("$SYS/x", "stadimeter/it/event/alarm", "stadimeter/it", "")):
        asker.send("explain", json.dumps({"rule": "no", "transaction": number}), ResponseTopic=topic)
        assert "there is no rule 'no'" in asker.answer("explain", number)["error"]
    assert all("there is no rule" not in each.payload for each in asker.heard if "event" in each.topic)


WRONG = {
    b"": "this is not JSON",
    b"PRESS": "this is not JSON",
    b"\xff\xfe": "this is not JSON",
    b"[" * 4000: "this is not JSON",
    b'{"why":' * 500: "this is not JSON",
    b"[]": "a request is a JSON object, such as {}",
    b"null": "a request is a JSON object, such as {}",
    b'{"rul": "near"}': "rul: extra inputs are not permitted",
    b'{"rule": 7}': "rule: input should be a valid string",
    b'{"rule": "near", "for_s": NaN}': "for_s: input should be a finite number",
    b'{"rule": "near", "for_s": -Infinity}': "for_s: input should be a finite number",
    b'{"rule": "near", "for_s": 1e300}': "for_s: input should be less than",
    b'{"rule": "near", "for_s": -1}': "for_s: input should be greater than 0",
    b'{"rule": "near", "one_shot": 1}': "one_shot: input should be a valid boolean",
    b'{"by": "a\\nb"}': "by: write one line of text",
    b'{"transaction": 1.5}': "transaction",
    b'{"why": "' + b"x" * 501 + b'"}': "why: string should have at most 500 characters",
    b'{"why": "' + b"x" * 5000 + b'"}': "a request has 4096 bytes at most",
}


@pytest.mark.long
def test_what_is_no_request_is_refused_with_a_reason_and_counted(start: Start) -> None:
    run, asker = start(protocol="5")
    for payload, words in WRONG.items():
        asker.forget()
        asker.send("shelve", payload)
        assert words in json.loads(asker.wait_for("stadimeter/it/response/shelve").payload)["error"], payload
        eventually(lambda: asker.ask("status"))
    refused = run.commands["refused"]
    assert refused["too_large"] == 1
    assert refused["invalid"] == len(WRONG) - 1
    assert run.given() == []


@pytest.mark.parametrize("protocol", ["5", "3.1.1"])
def test_a_command_that_the_broker_keeps_is_never_done(
    protocol: str, tmp_path: Path, broker: MosquittoBroker, closing: ExitStack, start: Start
) -> None:
    early = closing.enter_context(MqttAsker(broker.port, is_v5=False))
    early.send("shelve", '{"rule": "near"}', retain=True).wait_for_publish(120)
    run, asker = start(protocol=protocol, is_v5=protocol == "5", commands="all")
    if protocol == "5":
        asker.forget()
        asker.send("take-out", '{"rule": "near"}', retain=True)
        assert "kept by the broker" in json.loads(asker.wait_for("stadimeter/it/response/take-out").payload)["error"]
    eventually(lambda: run.commands["refused"].get("retained") == 1)
    eventually(lambda: any("is not done: it would come again" in line for line in run.told))
    assert asker.ask("acknowledge", rule="near")["words"] == "acknowledge: near"
    eventually(run.given)  # the answer goes out before the cycle ends that the command is a part of
    assert [action for action, _, _ in run.given()] == ["acknowledge"]
    assert sum("would come again" in line for line in run.told) == 1


VALUES: list[Any] = [
    *(None, True, -1, 0, 1e308, 1e400, float("nan"), float("-inf"), 2**70),
    *("", "near", "\ud800", "a\0b", [], {}),
]
HUGE = b'{"why": "' + b"x" * 1_000_000 + b'"}'
# 10,000 for the figures of the benchmarks; each takes a few ms.
MESSAGES = int(os.environ.get("STADIMETER_MESSAGES", "500"))
# To each topic: more than twice of what one takes at once.
FLOOD = 40


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("action", OFFERS)
def test_messages_of_any_kind_move_nothing_and_each_is_counted(
    action: str, start: Start, broker: MosquittoBroker, closing: ExitStack
) -> None:
    run, asker = start(protocol="5", commands="alarms")
    asker.ask("stop-outputs", why="nothing must move from now on")
    counted_before, before = sum_of(run.commands), len(run.records)
    rng = random.Random(action)  # noqa: S311 - the same each time
    pool = [*WRONG, *(make_payload(rng) for _ in range(2000))]
    retained = huge = 0
    for number in range(MESSAGES):
        payload = HUGE if number % 250 == 0 else rng.choice(pool)
        is_retained = number % 97 == 0 and payload is not HUGE
        huge += payload is HUGE
        retained += is_retained
        sent = asker.send(action, payload, retain=is_retained)
        if number % 10 == 9:  # no more at a time than a topic may have under way
            sent.wait_for_publish(120)
            expected = counted_before + number + 1 - huge
            eventually(lambda expected=expected: sum_of(run.commands) == expected)
    refused = run.commands["refused"]
    assert refused["retained"] == retained
    assert "too_many" not in refused
    assert run.loop.troubles == []
    assert run.is_alive
    asker.forget()
    assert isinstance(asker.ask("status"), dict)
    assert len(run.records) > before
    moved = [each for record in run.records[before + 2 :] for each in record.applied if each.level]
    assert moved == []
    assert {given for given, _, _ in run.given()} <= {action, "stop-outputs"}


def sum_of(commands: dict[str, Any]) -> int:
    """Return how many messages were done or refused."""
    return int(commands["done"]) + sum(commands["refused"].values())


def make_payload(rng: random.Random) -> bytes:
    """Return a payload that is hardly ever a request."""
    kind = rng.randrange(5)
    if kind == 0:
        return rng.randbytes(rng.randrange(300))
    if kind == 1:
        return b'{"why":' * rng.randrange(500) + b"[" * rng.randrange(500)
    if kind == 2:
        damaged = bytearray(b'{"rule": "near", "by": "zoe", "why": "seen", "for_s": 600, "transaction": "7"}')
        for _ in range(rng.randrange(1, 4)):
            damaged[rng.randrange(len(damaged))] = rng.randrange(256)
        return bytes(damaged)
    keys = rng.sample(["rule", "by", "why", "for_s", "one_shot", "transaction", "do", "ago_s", "op", "x"], 3)
    return json.dumps({key: rng.choice(VALUES) for key in keys}).encode()


@pytest.mark.long
def test_a_flood_holds_up_neither_the_loop_nor_a_stop(start: Start, broker: MosquittoBroker) -> None:
    run, asker = start(protocol="5")
    before, flooded = len(run.records), OFFERS.keys() - {"stop-outputs", "status"}
    for _ in range(FLOOD):
        for name in flooded:
            asker.send(name, b'{"rule": "no such rule"}')
    assert "words" in asker.ask("stop-outputs")
    eventually(lambda: len(run.records) > before + 10)
    assert run.loop.troubles == []
    assert [given for given, _, _ in run.given() if given in {"arm", "release-outputs"}] == []


def shown_commands() -> list[str]:
    page = (Path(__file__).parents[2] / "docs" / "mqtt.md").read_text(encoding="utf-8")
    return re.findall(r"^ *(mosquitto_.*)$", page, re.MULTILINE)


@pytest.mark.long
@needs("mosquitto_rr")
def test_the_orders_of_the_page_work_as_they_stand_there(start: Start, broker: MosquittoBroker) -> None:
    run, _ = start()
    commands = shown_commands()
    assert commands
    for command in commands:
        typed = command.replace("garage", "it").replace("too-close", "near")
        words = shlex.split(typed.replace("-h 192.168.1.10", f"-h 127.0.0.1 -p {broker.port}"))
        if words[0] == "mosquitto_sub":
            words += ["-C", "1"]  # until its first message
        done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=True)
        if words[0] == "mosquitto_rr":
            answer = json.loads(done.stdout)
            assert answer["status"] == "ok", (command, answer)
        if words[0] == "mosquitto_sub":
            assert done.stdout.startswith("stadimeter/it/")
    eventually(lambda: len(run.given()) == sum("/request/" in each for each in commands))
