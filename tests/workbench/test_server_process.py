"""What the workbench process answers on a pipe. The page's tests ask the whole process."""

from __future__ import annotations

import json
import os
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest

from stadimeter.errors import DriverError
from stadimeter.workbench.server.operations import Desk, DeskReply
from stadimeter.workbench.server.process import REQUEST_MAX_BYTES, serve

pytestmark = pytest.mark.vision


def _exchanged(desk: Desk, *lines: bytes) -> list[dict[str, Any]]:
    """Return the answers of `serve` to lines; a file holds more of them than a pipe that nobody reads yet."""
    asked = desk.configuration.with_name("requests")
    asked.write_bytes(b"".join(line + b"\n" for line in lines))
    answers = BytesIO()
    with asked.open("rb", buffering=0) as requests:
        serve(desk, requests, answers)
    return [json.loads(line) for line in answers.getvalue().splitlines()]


def test_what_is_no_request_is_refused_and_the_next_is_answered(tmp_path: Path) -> None:
    bad = (b"", b"{", b"[]", b'{"op": 1}', b'{"op": "nothing"}', b"x" * (REQUEST_MAX_BYTES + 10), b"[" * 100_000)
    *refused, answered = _exchanged(Desk(configuration=tmp_path / "a.toml"), *bad, b'{"op": "setup_operations.state"}')
    assert [each["status"] for each in refused] == ["error"] * len(bad)
    assert answered["data"]["question"] is None


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
