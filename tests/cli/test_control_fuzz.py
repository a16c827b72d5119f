"""A running instance under everything that can come in at its socket: an honest client is answered all the time."""

import json
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest

from stadimeter.app.control.client import ask
from stadimeter.app.control.messages import ARGS
from stadimeter.app.places import is_alive
from stadimeter.testing.rig import eventually
from support.simulated_run import SIMULATED_BALL

CONFIG = (
    SIMULATED_BALL
    + """
[rules.near]
actuator = "motor"
when = { below = "3 m" }
on_delay = "0 s"
ack = "required"
shelve_max = "1 h"
[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
loop = false
"""
)

STRANGE = (
    *("near", "", "\ud800", "\udcff", "\x00", "\u2028", "a" * 300, "é" * 150, "\x1b[2J", "near\n"),
    *(0, -1, 1e308, -1e308, 10**30, 10**4000, True, None, float("nan"), float("inf")),
    *([], {}, [[[]]], {"a": {"b": 1}}, ["near"] * 50),
)


GROWTH_MAX_KB = 40_000
"""What an allocator keeps of buffers for pictures, and what is remembered of the last five minutes."""

SURVIVED = sorted(set(ARGS) - {"restart"})
KEYS = ("rule", "by", "why", "for_s", "one_shot", "rate_hz", "image", "quality", "encoding", "output", "level", "x_m")
MEANT = {
    "image": ("none", "plain", "drawn"),
    "encoding": ("jpeg", "raw"),
    "rate_hz": (0.5, 10),
    "quality": (10, 95),
    "output": ("motor",),
    "level": (0, 0.5, 1),
    "target": ("ball",),
    "x_m": (1.0, -3.0),
}
"""What some operation understands."""


@pytest.fixture
def instance(tmp_path):
    config = tmp_path / "door.toml"
    config.write_text(CONFIG)
    path = tmp_path / "door.sock"
    with (tmp_path / "said").open("w") as said:
        process = subprocess.Popen(
            [sys.executable, "-m", "stadimeter", "run", config, "--socket", path, "--state", tmp_path / "state"],
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=said,
            start_new_session=True,
        )
    assert eventually(lambda: is_alive(path))
    yield path
    process.send_signal(signal.SIGTERM)
    assert process.wait(120) == 0
    said = (tmp_path / "said").read_text()
    assert "Ended: SIGTERM." in said
    assert "Traceback" not in said


def connected(path):
    client = socket.socket(socket.AF_UNIX)
    client.settimeout(10)
    while True:
        try:
            client.connect(os.fspath(path))
        except BlockingIOError:  # more connections than may wait to be accepted
            time.sleep(0.001)
        else:
            return client


def request(chance):
    """Return something that was a request once."""
    args = {key: chance.choice(STRANGE) for key in KEYS if chance.random() < 0.1}
    args |= {key: chance.choice(values) for key, values in MEANT.items() if chance.random() < 0.1}
    wanted = {"transaction": chance.choice(STRANGE), "op": chance.choice([*SURVIVED, *STRANGE]), "args": args}
    for key in list(wanted):
        if chance.random() < 0.2:
            del wanted[key]
    line = bytearray(json.dumps(wanted, ensure_ascii=chance.random() < 0.7).encode("utf-8", "surrogatepass"))
    for _ in range(chance.choice((0, 0, 0, 1, 2, 10))):
        line[chance.randrange(len(line))] = chance.randrange(256)
    if chance.random() < 0.1:
        line = line[: chance.randrange(len(line))]
    if chance.random() < 0.05:
        line = bytearray(chance.choice((b"[" * 30_000, b'{"a":' * 5_000, chance.randbytes(5_000), b"9" * 60_000)))
    if chance.random() < 0.01:
        line *= 70_000 // max(1, len(line)) + 1
    return bytes(line) + b"\n"


def fuzz(path, chance, count):
    """Send requests, on connections that are used more than once, and given up in every way."""
    client = connected(path)
    for _ in range(count):
        with suppress(OSError):  # it was hung up on
            client.sendall(request(chance))
            if chance.random() < 0.6:
                client.recv(65536)
        if chance.random() < 0.3:
            client.close()
            client = connected(path)
    client.close()


def never_read(path, stopped):
    """Ask and never read an answer; come back when hung up on."""
    while not stopped.is_set():
        with connected(path) as client:
            client.settimeout(0.2)
            try:
                while not stopped.is_set():
                    with suppress(TimeoutError):
                        client.send(b'{"op": "status"}\n')
            except OSError:
                continue


def half_read(path, stopped, chance):
    """Subscribe, read a part of what comes, and hang up, or wait to be hung up on."""
    while not stopped.is_set():
        with connected(path) as client, suppress(OSError):
            image = chance.choice(("none", "plain", "drawn"))
            client.sendall(json.dumps({"op": "subscribe", "args": {"image": image}}).encode() + b"\n")
            for _ in range(chance.randrange(5)):
                client.recv(chance.choice((1, 100, 65536)))
            stopped.wait(chance.choice((0.0, 0.1, 1.0)))


def memory_kb(path):
    """Return the resident memory of an instance."""
    status = Path(f"/proc/{ask(path, 'hello')['pid']}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0])


def honest(path, stopped, waited_s):
    """Ask all the time as `stadimeter status` does, and note how long each answer takes."""
    while not stopped.wait(0.01):
        began_s = time.monotonic()
        assert ask(path, "status")["rules"]
        waited_s.append(time.monotonic() - began_s)


@pytest.mark.parametrize(
    ("count", "idle"), [(20, 5), pytest.param(10_000, 200, marks=[pytest.mark.long, pytest.mark.timeout(1800)])]
)
def test_whatever_comes_in_an_honest_client_is_answered(instance, count, idle):
    stopped, waited_s = threading.Event(), []
    eventually(lambda: ask(instance, "status"))
    threads = [
        threading.Thread(target=honest, args=(instance, stopped, waited_s)),
        threading.Thread(target=never_read, args=(instance, stopped)),
        threading.Thread(target=half_read, args=(instance, stopped, random.Random(8))),  # noqa: S311 - likewise
    ]
    with ExitStack() as closing:
        for _ in range(idle):
            closing.enter_context(connected(instance))
        for thread in threads:
            thread.start()
        try:
            # First so that every part of it is loaded, with the threads and pictures of all who ask at once.
            fuzz(instance, random.Random(6), count // 10)  # noqa: S311 - likewise
            before_kb = memory_kb(instance)
            fuzz(instance, random.Random(7), count)  # noqa: S311 - nothing secret depends on it
            eventually(lambda: len(waited_s) > 2)  # on a busy machine the honest one takes its time
        finally:
            is_honest_served = threads[0].is_alive()
            stopped.set()
            for thread in threads:
                thread.join()
    assert is_honest_served
    assert eventually(lambda: memory_kb(instance)) < before_kb + GROWTH_MAX_KB
    waited_s.sort()
    print(f"{len(waited_s)} honest requests: median {waited_s[len(waited_s) // 2]:.3f} s, longest {waited_s[-1]:.3f} s")
