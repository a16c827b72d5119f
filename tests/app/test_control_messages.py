"""What may be asked of a running instance: whatever comes, it is a request or a refusal in words."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.app.control.messages import ARGS, Reply, operator_command, parse_request, transaction_of
from stadimeter.errors import ControlError
from stadimeter.operator_actions import OperatorAction
from support.each_case import each_case

ANYTHING = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text() | st.sampled_from([*ARGS, "rule", "op"]),
    lambda inner: st.lists(inner) | st.dictionaries(st.sampled_from(["op", "args", "transaction", "rule"]), inner),
)


@given(line=st.binary() | ANYTHING.map(lambda value: json.dumps(value).encode()))
def test_any_bytes_are_a_request_or_are_refused_in_words(line):
    transaction = transaction_of(line)
    try:
        request = parse_request(line)
    except ControlError as error:
        answer = json.loads(Reply(error=str(error)).line(transaction))
        assert answer["status"] == "error"
        assert answer["error"]
    else:
        assert request.op in ARGS
        assert request.transaction == transaction


@each_case("op", sorted({*ARGS} - {"hold-output", "record"}))
def test_an_operation_needs_no_more_than_its_name(op):
    assert parse_request(json.dumps({"op": op}).encode()).op == op


@pytest.mark.parametrize(
    ("op", "action"),
    [
        ("ack", OperatorAction.ACKNOWLEDGE),
        ("reset", OperatorAction.RESET),
        ("unshelve", OperatorAction.UNSHELVE),
        ("take-out", OperatorAction.TAKE_OUT),
        ("put-back", OperatorAction.PUT_BACK),
    ],
)
def test_what_an_operator_says_reaches_the_core_as_it_was_said(op, action):
    line = json.dumps({"op": op, "args": {"rule": "near", "by": "Zoë", "why": "seen"}}).encode()
    command = operator_command(parse_request(line), "7")
    assert (command.id, command.action, command.rule, command.by, command.why) == ("7", action, "near", "Zoë", "seen")


@pytest.mark.parametrize(
    ("op", "action"),
    [("stop-outputs", OperatorAction.STOP_OUTPUTS), ("release-outputs", OperatorAction.RELEASE_OUTPUTS)],
)
def test_what_concerns_every_output_names_none_and_no_rule(op, action):
    line = json.dumps({"op": op, "args": {"by": "Zoë", "why": "a child"}}).encode()
    command = operator_command(parse_request(line), "7")
    assert (command.action, command.rule, command.by, command.why) == (action, "", "Zoë", "a child")
    with pytest.raises(ControlError, match=r"args\.output"):
        parse_request(json.dumps({"op": op, "args": {"output": "motor"}}).encode())


@pytest.mark.parametrize("level", [True, "0.5", [1]])
def test_what_is_no_number_is_no_level_to_hold_an_output_at(level):
    line = json.dumps({"op": "hold-output", "args": {"output": "motor", "level": level}}).encode()
    with pytest.raises(ControlError, match=r"args\.level"):
        parse_request(line)


def test_how_to_shelve_reaches_the_core_too():
    line = b'{"op": "shelve", "args": {"rule": "near", "for_s": 60, "one_shot": true}}'
    command = operator_command(parse_request(line), "7")
    assert (command.action, command.for_s, command.one_shot) == (OperatorAction.SHELVE, 60.0, True)


def test_an_answer_is_one_line_whatever_is_in_it():
    line = Reply({"words": "two\nlines and a Ω"}).line("a\nb")
    assert line.count(b"\n") == 1
    assert json.loads(line) == {"transaction": "a\nb", "status": "ok", "data": {"words": "two\nlines and a Ω"}}
