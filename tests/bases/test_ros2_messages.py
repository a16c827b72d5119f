from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.bases.differential_drive import Motion
from stadimeter.bases.ros2_messages import type_name, velocity_cdr, velocity_json

pytest.importorskip("rosbags", reason="an independent decoder of CDR, of the group dev")

from rosbags.typesys import Stores, get_typestore

SPEEDS = st.floats(allow_nan=False, allow_infinity=False)
STORE = get_typestore(Stores.ROS2_JAZZY)


@given(linear_mps=SPEEDS, angular_radps=SPEEDS, frame_id=st.text(st.characters(codec="ascii", exclude_characters="\0")))
@pytest.mark.parametrize("message", ["Twist", "TwistStamped"])
def test_an_independent_decoder_reads_what_was_written(
    message: str, linear_mps: float, angular_radps: float, frame_id: str
) -> None:
    motion = Motion(linear_mps=linear_mps, angular_radps=angular_radps)
    data = velocity_cdr(motion, message, frame_id)
    read = STORE.deserialize_cdr(data, type_name(message))
    twist = read if message == "Twist" else read.twist
    assert (twist.linear.x, twist.linear.y, twist.linear.z) == (linear_mps, 0.0, 0.0)
    assert (twist.angular.x, twist.angular.y, twist.angular.z) == (0.0, 0.0, angular_radps)
    if message == "TwistStamped":
        assert (read.header.frame_id, read.header.stamp.sec, read.header.stamp.nanosec) == (frame_id, 0, 0)
    assert bytes(STORE.serialize_cdr(read, type_name(message))) == data


@pytest.mark.parametrize("message", ["Twist", "TwistStamped"])
def test_json_has_the_fields_of_the_type_and_no_others(message: str) -> None:
    fields = velocity_json(Motion(linear_mps=0.3, angular_radps=-0.5), message, "base_link")
    names = [name for name, _ in STORE.fielddefs[type_name(message)][1]]
    assert [*fields] == names
    twist = fields if message == "Twist" else fields["twist"]
    assert (twist["linear"]["x"], twist["angular"]["z"]) == (0.3, -0.5)
