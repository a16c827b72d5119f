"""A base beside busy loops: nothing that is well is called a fault, and what is wrong is found and mended."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.long


def test_a_busy_computer_is_no_fault_of_the_base():
    from base_under_load import busy_cores, healthy_run

    with busy_cores():
        outcome = healthy_run(10)
    assert outcome.drove
    assert outcome.faults == []


@pytest.mark.timeout(120)
def test_beside_busy_loops_a_base_with_a_real_fault_is_stopped_identified_again_and_drives_after_its_rest():
    from base_under_load import Rig, busy_cores

    with busy_cores(), Rig(seconds=100) as rig:
        for fault, end, words in (
            ("silence", "answer", "has acknowledged nothing"),
            ("do not read", "read", "has not taken"),
            ("unplug", "plug", "unplugged"),
        ):
            rig.wait_for("base 0.3")
            rig.tell_board(fault)
            assert words in rig.wait_for("safety: base fault")
            rig.tell_board(end)
            rig.wait_for("it answers again")
            assert rig.board()["driven_tps"] == 0
            rig.wait_for("base fault cleared")
        rig.wait_for("base 0.3")
        rig.program.terminate()
        assert rig.program.wait(20) == 0
