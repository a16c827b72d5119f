"""From motions to wheels, and every codec against the wire vectors of its protocol and against noise."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from stadimeter.bases.ascii_base import AsciiBaseOptions, AsciiCodec
from stadimeter.bases.hoverboard import HoverboardCodec
from stadimeter.bases.protocol import DifferentialDrive, Motion, WheelSpeeds
from stadimeter.bases.roomba_base import RoombaCodec
from stadimeter.bases.ros_arduino_base import FRAME_S, RosArduinoCodec
from stadimeter.bases.serial_base import BaseMessage, SerialCodec
from stadimeter.bases.waveshare_ugv import WaveshareUgvCodec
from support.base_bench import vectors, wire
from support.each_case import each_case

# Every codec against the wire vectors of its protocol, and against noise.


def wheels(left_mps: float, right_mps: float) -> WheelSpeeds:
    return WheelSpeeds(left_mps=left_mps, right_mps=right_mps)


OPENBOT_OPTIONS = AsciiBaseOptions.model_validate(
    {
        "port": "/dev/ttyUSB0",
        "track_width": "15 cm",
        "drive": "c{left:d},{right:d}\n",
        "stop": "c0,0\n",
        "opening": ["h750\n"],
        "question": "f\n",
        "answers": {"identity": "f[A-Z].*", "battery": "v([0-9.]+)"},
        "full_speed": "255 m/s",
        "auto_stop": "750 ms",
    }
)

# A tick per frame, a unit or a duty of 1 in 255 is a metre a second here.
ROS, WAVESHARE, HOVERBOARD, OPENBOT = "ros_arduino_bridge", "waveshare_ugv_json", "hoverboard_foc", "openbot_ascii"
OI = "irobot_oi"
CODECS: dict[str, Callable[[], SerialCodec]] = {
    ROS: lambda: RosArduinoCodec(ticks_per_metre=1 / FRAME_S),
    WAVESHARE: lambda: WaveshareUgvCodec(auto_stop_s=0.3),
    HOVERBOARD: lambda: HoverboardCodec(full_speed_mps=1000.0, rpm_mps=0.01),
    OPENBOT: lambda: AsciiCodec(OPENBOT_OPTIONS),
    OI: RoombaCodec,
}

# A header that is none may announce a frame of so many bytes.
LONGEST = {OI: 175}

# What we send, for each vector to the base: what it is sent by.
SENT: dict[tuple[str, str], Callable[[SerialCodec], bytes]] = {
    (ROS, "closed_loop_10_10"): lambda codec: codec.encode(wheels(10, 10)).frame,
    (ROS, "stop"): lambda codec: codec.stop,
    (ROS, "read_encoders"): lambda codec: codec.polls[0],
    (ROS, "reset_encoders"): lambda codec: codec.opening[0],
    (ROS, "baud"): lambda codec: codec.question,
    (OI, "init_safe"): lambda codec: b"".join(codec.wake),
    (OI, "stop_drive_direct"): lambda codec: codec.stop,
    (OI, "drive_direct_r-200_l500"): lambda codec: codec.encode(wheels(0.5, -0.2)).frame,
    (OI, "shutdown"): lambda codec: b"".join(codec.closing),
    (WAVESHARE, "wheels_zero"): lambda codec: codec.stop,
    (WAVESHARE, "wheels_0.5"): lambda codec: codec.encode(wheels(0.5, 0.5)).frame,
    (WAVESHARE, "heartbeat_300ms"): lambda codec: codec.opening[0],
    (WAVESHARE, "echo_off"): lambda codec: codec.opening[1],
    (WAVESHARE, "feedback_interval"): lambda codec: codec.opening[2],
    (WAVESHARE, "feedback_continuous"): lambda codec: codec.opening[3],
    (WAVESHARE, "feedback_once"): lambda codec: codec.question,
    (HOVERBOARD, "zero"): lambda codec: codec.stop,
    (HOVERBOARD, "steer0_speed100"): lambda codec: codec.encode(wheels(100, 100)).frame,
    (HOVERBOARD, "steer0_speed-100"): lambda codec: codec.encode(wheels(-100, -100)).frame,
    (HOVERBOARD, "steer100_speed200"): lambda codec: codec.encode(wheels(250, 150)).frame,
    (HOVERBOARD, "steer-50_speed300"): lambda codec: codec.encode(wheels(275, 325)).frame,
    (OPENBOT, "control_128_128"): lambda codec: codec.encode(wheels(128, 128)).frame,
    (OPENBOT, "heartbeat_750ms"): lambda codec: codec.opening[0],
    (OPENBOT, "feature_request"): lambda codec: codec.question,
}

COUNT_M = math.pi * 0.072 / 508.8
IN_FULL_MODE = BaseMessage(battery_v=15.776, left_m=2813 * COUNT_M, right_m=2409 * COUNT_M)

# What we hear in each vector from the base.
HEARD: dict[tuple[str, str], list[BaseMessage]] = {
    (ROS, "ok"): [BaseMessage(was_done=True)],
    (ROS, "invalid_command"): [BaseMessage(was_done=False)],
    (ROS, "baud_57600"): [BaseMessage(is_identity=True)],
    (ROS, "encoders_0_0"): [BaseMessage(left_m=0.0, right_m=0.0)],
    (OI, "stream_frame_29_13"): [BaseMessage()],
    (OI, "stream_frame_sum512"): [BaseMessage()],
    (OI, "stream_frame_42_bytes"): [IN_FULL_MODE],
    (OI, "stream_resync"): [IN_FULL_MODE],
    (WAVESHARE, "feedback"): [BaseMessage(is_identity=True, battery_v=12.03, left_m=0.12, right_m=0.13)],
    (HOVERBOARD, "feedback"): [BaseMessage(is_identity=True, battery_v=36.5, left_mps=-0.5, right_mps=-0.5, errors=())],
    (OPENBOT, "features"): [BaseMessage(is_identity=True)],
    (OPENBOT, "voltage"): [BaseMessage(battery_v=12.03)],
}


@each_case(("protocol", "name"), SENT)
def test_a_command_is_these_bytes_exactly(protocol: str, name: str) -> None:
    assert SENT[protocol, name](CODECS[protocol]()) == wire(protocol, name)


@each_case(("protocol", "name"), HEARD)
def test_these_bytes_mean_this(protocol: str, name: str) -> None:
    assert CODECS[protocol]().feed(wire(protocol, name)) == HEARD[protocol, name]


@pytest.mark.parametrize(
    ("protocol", "name"), [(each, name) for each in CODECS for name in vectors(each, "rx", valid=False)]
)
def test_bytes_that_are_no_frame_mean_nothing_and_are_counted(protocol: str, name: str) -> None:
    codec = CODECS[protocol]()
    assert codec.feed(wire(protocol, name)) == []
    assert codec.dropped_bytes


@each_case("protocol", CODECS)
@each_case("speed_mps", [-1.7, -0.3, 0.0, 1e-9, 0.31, 2.0])
def test_frames_that_must_never_be_sent_are_not(protocol: str, speed_mps: float) -> None:
    codec = CODECS[protocol]()
    never = [wire(protocol, name) for name in vectors(protocol, "tx", valid=False)]
    assert not {codec.stop, codec.question, codec.encode(wheels(speed_mps, -speed_mps)).frame} & {*never}


@pytest.mark.parametrize("protocol", CODECS)
@given(data=st.data())
def test_bytes_mean_the_same_however_they_are_split(protocol: str, data: st.DataObject) -> None:
    frames = st.sampled_from([wire(protocol, name) for name in vectors(protocol, "rx")])
    stream = data.draw(st.lists(frames | st.binary(max_size=60), max_size=10).map(b"".join))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    whole, pieces = CODECS[protocol](), CODECS[protocol]()
    bounds = zip([0, *cuts], [*cuts, len(stream)], strict=True)
    assert [each for a, b in bounds for each in pieces.feed(stream[a:b])] == whole.feed(stream)
    assert pieces.dropped_bytes == whole.dropped_bytes


@pytest.mark.parametrize("protocol", CODECS)
@given(noise=st.binary(max_size=200))
def test_behind_any_noise_the_third_frame_at_the_latest_is_understood(protocol: str, noise: bytes) -> None:
    """Noise may look like the head of a frame, and then it takes what follows with it, but not for long."""
    for name in vectors(protocol, "rx", valid=True):
        codec, frame = CODECS[protocol](), wire(protocol, name)
        codec.feed(noise)
        heard = [message for _ in range(3 + 256 // len(frame)) for message in codec.feed(frame)]
        assert heard[-1] == HEARD[protocol, name][-1], name


@pytest.mark.parametrize("protocol", CODECS)
def test_a_frame_cut_short_takes_at_most_the_next_or_the_longest_with_it(protocol: str) -> None:
    for name in vectors(protocol, "rx", valid=True):
        frame = wire(protocol, name)
        for length in range(1, len(frame)):
            codec = CODECS[protocol]()
            heard = codec.feed(frame[:length] + frame * (2 + LONGEST.get(protocol, 0) // len(frame)))
            assert heard[-1:] == HEARD[protocol, name][-1:], (name, length)


@pytest.mark.parametrize("protocol", CODECS)
def test_frames_back_to_back_are_all_heard(protocol: str) -> None:
    stream, expected = b"", []
    for name in [*vectors(protocol, "rx", valid=True)] * 2:
        stream += wire(protocol, name)
        expected += HEARD[protocol, name]
    assert CODECS[protocol]().feed(stream) == expected


DRIVE = DifferentialDrive(track_width_m=0.16, max_wheel_mps=0.5)
speeds = st.floats(-5, 5)


def motion(linear_mps: float, angular_radps: float) -> Motion:
    return Motion(linear_mps=linear_mps, angular_radps=angular_radps)


def test_a_turn_to_the_left_runs_the_right_wheel_forwards_and_the_left_one_backwards() -> None:
    assert DRIVE.wheels(motion(0.0, 1.0)) == WheelSpeeds(left_mps=-0.08, right_mps=0.08)


@given(speeds, speeds)
def test_no_wheel_is_ever_faster_than_its_limit(linear_mps: float, angular_radps: float) -> None:
    wheels = DRIVE.wheels(motion(linear_mps, angular_radps))
    assert max(abs(wheels.left_mps), abs(wheels.right_mps)) <= DRIVE.max_wheel_mps * (1 + 1e-9)


@given(speeds, speeds)
def test_a_motion_within_the_limit_is_kept(linear_mps: float, angular_radps: float) -> None:
    assume(abs(linear_mps) + abs(angular_radps) * 0.08 < 0.5)
    kept = DRIVE.motion(DRIVE.wheels(motion(linear_mps, angular_radps)))
    assert (kept.linear_mps, kept.angular_radps) == pytest.approx((linear_mps, angular_radps), abs=1e-9)


@given(st.floats(0.6, 5), st.floats(-20, 20))
def test_a_motion_over_the_limit_keeps_its_curve(linear_mps: float, angular_radps: float) -> None:
    kept = DRIVE.motion(DRIVE.wheels(motion(linear_mps, angular_radps)))
    wanted = math.atan2(angular_radps * 0.08, linear_mps)
    assert math.atan2(kept.angular_radps * 0.08, kept.linear_mps) == pytest.approx(wanted, abs=1e-6)
