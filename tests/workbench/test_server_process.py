"""The workbench process, asked over a real pipe as the page asks it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stadimeter.app.control.framing import attached_bytes
from stadimeter.errors import DriverError
from stadimeter.workbench.server.operations import Desk, DeskReply
from stadimeter.workbench.server.process import REQUEST_MAX_BYTES, serve

pytestmark = pytest.mark.vision


class Asked:
    """A workbench process on a pipe."""

    def __init__(self, configuration: Path) -> None:
        command = [sys.executable, "-m", "stadimeter.workbench.server.process", str(configuration)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def __call__(self, op: str, **args: object) -> tuple[dict[str, Any], bytes]:
        """Return the answer and the bytes behind it."""
        return self.send(json.dumps({"transaction": op, "op": op, "args": args}).encode())

    def send(self, line: bytes) -> tuple[dict[str, Any], bytes]:
        """Send a line as it is."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(line + b"\n")
        self.process.stdin.flush()
        answer = json.loads(self.process.stdout.readline())
        return answer, self.process.stdout.read(attached_bytes(answer))

    def end(self) -> int:
        """Close the pipe, and return the exit code."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        code = self.process.wait(timeout=120)
        self.process.stdout.close()
        return code


@pytest.fixture
def asked(tmp_path: Path) -> Iterator[Asked]:
    process = Asked(tmp_path / "stadimeter.toml")
    yield process
    assert process.end() == 0


@pytest.mark.long
def test_the_process_asks_the_questions_of_init_and_shows_what_the_camera_sees(asked: Asked) -> None:
    assert asked("setup_operations.state")[0]["data"]["question"] is None
    assert asked("setup_operations.begin")[0]["data"]["question"]["kind"] == "camera"
    answered, _ = asked("setup_operations.answer", answer="simulated")
    assert answered["data"]["question"]["kind"] == "target"
    answer, jpeg = asked("setup_operations.picture", draw="plain", width_px=320)
    picture = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (240, 320, 3)
    assert (answer["data"]["width_px"], answer["data"]["height_px"]) == (640, 480)
    for bad in (b"", b"{", b"[]", b'{"op": 1}', b'{"op": "nothing"}', b"x" * (REQUEST_MAX_BYTES + 10), b"[" * 100_000):
        assert asked.send(bad)[0]["status"] == "error"
    assert asked("setup_operations.back")[0]["data"]["question"]["kind"] == "camera"


def _exchanged(desk: Desk, *lines: bytes) -> list[dict[str, Any]]:
    """Return the answers of `serve` to lines on a pipe."""
    in_end, in_start = os.pipe()
    out_end, out_start = os.pipe()
    with os.fdopen(in_end, "rb", buffering=0) as requests, os.fdopen(out_start, "wb") as answers:
        os.write(in_start, b"".join(line + b"\n" for line in lines))
        os.close(in_start)
        serve(desk, requests, answers)
    with os.fdopen(out_end, "rb") as told:
        return [json.loads(line) for line in told]


def test_a_defect_in_an_operation_is_told_and_ends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def divide(_desk: Desk, _args: object) -> DeskReply:
        return DeskReply(data=1 / 0)

    def fine(_desk: Desk, _args: object) -> DeskReply:
        return DeskReply(data="fine")

    monkeypatch.setattr(
        "stadimeter.workbench.server.process.find_operation", {"divide": divide, "fine": fine}.__getitem__
    )
    first, second = _exchanged(Desk(configuration=tmp_path / "a.toml"), b'{"op": "divide"}', b'{"op": "fine"}')
    assert first["status"] == "error"
    assert first["code"] == "defect"
    assert "ZeroDivisionError" in capfd.readouterr().err
    assert second["data"] == "fine"


def test_the_desk_comes_to_rest_at_the_end_even_if_nobody_reads_the_answer(tmp_path: Path) -> None:
    rested: list[str] = []

    def busy() -> None:
        raise DriverError("the camera does not close")

    desk = Desk(configuration=tmp_path / "a.toml", at_rest=[busy, lambda: rested.append("camera")])
    in_end, in_start = os.pipe()
    out_end, out_start = os.pipe()
    os.close(out_end)
    os.write(in_start, b'{"op": "setup_operations.state"}\n')
    with os.fdopen(in_end, "rb", buffering=0) as requests, os.fdopen(out_start, "wb", buffering=0) as answers:
        serve(desk, requests, answers)
    os.close(in_start)
    assert rested == ["camera"]
