"""What may be asked of a running instance: whatever comes, it is a request or a refusal in words."""

import json
import math

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


@pytest.mark.long
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


@each_case("op", sorted({*ARGS} - {"hold-output", "record", "set-threshold"}))
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
        ("observe", OperatorAction.OBSERVE),
        ("act", OperatorAction.ACT),
        ("withdraw-threshold", OperatorAction.WITHDRAW_THRESHOLD),
    ],
)
def test_what_an_operator_says_reaches_the_core_as_it_was_said(op, action):
    line = json.dumps({"op": op, "args": {"rule": "near", "by": "Zoë", "why": "seen"}}).encode()
    command = operator_command(parse_request(line), "7")
    assert (command.id, command.action, command.rule, command.by, command.why) == ("7", action, "near", "Zoë", "seen")


@pytest.mark.parametrize(
    ("written", "value", "unit"),
    [
        (0.6, 0.6, ""),
        (3, 3.0, ""),
        ("60 cm", 0.6, "m"),
        ("2 ft", 0.6096, "m"),
        ("1,5 s", 1.5, "s"),
        ("-90 deg", -math.pi / 2, "rad"),
        ("36 km/h", 10.0, "m/s"),
        ("11000 mV", 11.0, "V"),
    ],
)
def test_a_threshold_is_set_to_a_number_in_the_si_unit_or_to_a_text_with_a_unit(written, value, unit):
    line = json.dumps({"op": "set-threshold", "args": {"rule": "near", "value": written, "key": "below"}}).encode()
    command = operator_command(parse_request(line), "7")
    assert (command.action, command.rule, command.key) == (OperatorAction.SET_THRESHOLD, "near", "below")
    assert (command.value, command.unit) == (pytest.approx(value), unit)


@pytest.mark.parametrize(
    ("args", "error"),
    [
        ({"rule": "near", "value": "0.6"}, "args.value: '0.6' has no unit; write it with one, such as '60 cm'"),
        ({"rule": "near", "value": "9" * 1000}, "args.value: write a number in the SI unit, or a text with a unit"),
        ({"rule": "near", "value": "6 parsecs"}, "args.value: '6 parsecs': unknown unit 'parsecs'"),
        ({"rule": "near", "value": True}, "args.value: write a number in the SI unit, or a text with a unit"),
        ({"rule": "near", "value": 1e300}, "args.value: write a number in the SI unit, or a text with a unit"),
        ({"rule": "near", "value": math.nan}, "args.value: write a number in the SI unit, or a text with a unit"),
        ({"rule": "near", "value": None}, "args.value: write a number in the SI unit, or a text with a unit"),
        ({"rule": "near", "value": "1e12 m"}, "args.value: '1e12 m' is too large a number"),
        ({"rule": "near"}, "args.value: field required"),
        ({"value": 0.6}, "args.rule: field required"),
        ({"rule": "", "value": 0.6}, "args.rule: "),
    ],
)
def test_a_threshold_that_is_no_value_of_one_rule_is_refused_in_words(args, error):
    with pytest.raises(ControlError) as refused:
        parse_request(json.dumps({"op": "set-threshold", "args": args}).encode())
    assert str(refused.value).startswith(error)


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


def test_an_answer_is_one_line_whatever_is_in_it():
    line = Reply({"words": "two\nlines and a Ω"}).line("a\nb")
    assert line.count(b"\n") == 1
    assert json.loads(line) == {"transaction": "a\nb", "status": "ok", "data": {"words": "two\nlines and a Ω"}}
