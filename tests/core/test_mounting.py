"""Whether distances count as unconfirmed: from the finding of a check until a person confirms the mounting."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from stadimeter.core.camera_pose import Mounting, MountingStatus, step_mounting
from stadimeter.core.decision import EventKind
from stadimeter.operator_actions import OperatorAction, OperatorCommand

TURNED = Mounting(status=MountingStatus.UNCONFIRMED, reason="turned by 0.31°")
CONFIRM = OperatorCommand(id="1", action=OperatorAction.CONFIRM_MOUNTING, by="zoe", why="aimed at the gate")


def step(was, mounting, *commands):
    return step_mounting(was_unconfirmed=was, mounting=mounting, commands=commands, now_s=5.0)


def test_a_camera_that_was_moved_is_one_fault_however_long_it_lasts() -> None:
    is_unconfirmed, _, (event,) = step(False, TURNED)
    assert is_unconfirmed
    assert (event.kind, event.source) == (EventKind.FAULT, "mounting")
    assert "turned by 0.31°" in event.reason
    assert step(True, TURNED) == (True, (), ())


def test_confirming_it_ends_the_fault_and_says_who_did() -> None:
    is_unconfirmed, (answer,), (event,) = step(True, TURNED, CONFIRM)
    assert not is_unconfirmed
    assert answer.accepted
    assert (event.kind, event.by) == (EventKind.FAULT_CLEARED, "zoe")
    assert "aimed at the gate" in event.reason


def test_there_is_nothing_to_confirm_where_nothing_was_found() -> None:
    for mounting in (None, Mounting(), Mounting(status=MountingStatus.NOT_JUDGED, reason="dark")):
        is_unconfirmed, (answer,), events = step(False, mounting, CONFIRM)
        assert not is_unconfirmed
        assert not answer.accepted
        assert events == ()


def test_a_camera_without_a_saved_view_is_never_unconfirmed() -> None:
    assert step(False, None) == (False, (), ())


@given(st.lists(st.tuples(st.sampled_from([None, Mounting(), TURNED]), st.booleans()), max_size=30))
def test_faults_and_their_ends_alternate(cycles) -> None:
    was, kinds = False, []
    for mounting, confirms in cycles:
        was, answers, events = step(was, mounting, *([CONFIRM] if confirms else []))
        kinds += [event.kind for event in events]
        assert len(answers) == confirms
    assert kinds == [EventKind.FAULT, EventKind.FAULT_CLEARED] * (len(kinds) // 2) + [EventKind.FAULT] * (
        len(kinds) % 2
    )
    assert was == (len(kinds) % 2 == 1)
