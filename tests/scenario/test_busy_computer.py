"""A base beside busy loops: nothing that is well is called a fault, and what is wrong is found and mended."""

from __future__ import annotations

import queue
import subprocess
import sys
from contextlib import contextmanager, suppress

import pytest

from stadimeter.testing.rig import eventually
from support.program_and_board import PATIENCE_S, Rig

pytestmark = pytest.mark.long


@contextmanager
def busy_cores():
    """Keep two processes running that do nothing but count."""
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def test_a_busy_computer_is_no_fault_of_the_base():
    with busy_cores(), Rig(10) as rig:
        with suppress(queue.Empty):  # with a fault right at the beginning it never drives
            rig.wait_for("base 0.3")
        eventually(lambda: rig.board()["driven_mps"] > 0 or rig.program.poll() is not None)  # late pictures stop it
        assert rig.program.poll() is None
        rig.program.wait(10 + PATIENCE_S)
        assert rig.faults() == []


@pytest.mark.timeout(120)
def test_beside_busy_loops_a_base_with_a_real_fault_is_stopped_identified_again_and_drives_after_its_rest():
    with busy_cores(), Rig(seconds=100) as rig:
        for fault, end, words in (
            ("silence", "answer", ["has acknowledged nothing"]),
            # A busy program sends too little to fill the port before an answer is missed.
            ("do not read", "read", ["has not taken", "has acknowledged nothing"]),
            ("unplug", "plug", ["unplugged"]),
        ):
            rig.wait_for("base 0.3")
            rig.tell_board(fault)
            said = rig.wait_for("safety: base fault")
            assert any(each in said for each in words), said
            rig.tell_board(end)
            rig.wait_for("it answers again")
            assert rig.board()["driven_mps"] == 0
            rig.wait_for("base fault cleared")
        rig.wait_for("base 0.3")
        rig.program.terminate()
        assert rig.program.wait(20) == 0
