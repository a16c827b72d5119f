"""The frames of the laser sensor, however they arrive."""

import struct

from hypothesis import given
from hypothesis import strategies as st

from stadimeter.sensors.tf_luna import FrameDecoder, RangeFrame

# Distance 120 cm, strength 700, as the tables of the manual lay out a frame; the checksum is worked out by hand.
VECTOR = bytes.fromhex("5959 7800 bc02 9009 81")


def frame_of(distance_cm, strength):
    begun = b"\x59\x59" + struct.pack("<HHH", distance_cm, strength, 2300)
    return begun + bytes([sum(begun) & 0xFF])


frames = st.builds(frame_of, st.integers(0, 1200), st.integers(0, 0xFFFF))


def test_a_frame_says_how_far_and_how_strong():
    assert FrameDecoder().feed(VECTOR) == [RangeFrame(distance_m=1.2, strength=700)]


def test_a_wrong_checksum_is_no_frame():
    assert FrameDecoder().feed(VECTOR[:-1] + b"\x00") == []


def test_weak_and_overexposed_echoes_are_not_reliable():
    assert not RangeFrame(distance_m=1.0, strength=99).is_reliable
    assert not RangeFrame(distance_m=1.0, strength=0xFFFF).is_reliable
    assert not RangeFrame(distance_m=0.0, strength=500).is_reliable
    assert RangeFrame(distance_m=1.0, strength=100).is_reliable


@given(sent=st.lists(frames, min_size=1, max_size=5), cuts=st.lists(st.integers(1, 5), min_size=60, max_size=60))
def test_frames_are_the_same_however_they_are_split(sent, cuts):
    data, decoder, found = b"".join(sent), FrameDecoder(), []
    for size in cuts:
        found += decoder.feed(data[:size])
        data = data[size:]
    found += decoder.feed(data)
    assert [frame.strength for frame in found] == [struct.unpack_from("<H", each, 4)[0] for each in sent]


@given(noise=st.binary(max_size=40), sent=frames)
def test_after_noise_the_second_frame_is_found_at_the_latest(noise, sent):
    decoder = FrameDecoder()
    decoder.feed(noise)
    found = [frame for _ in range(3) for frame in decoder.feed(sent)]
    assert struct.unpack_from("<H", sent, 4)[0] in [frame.strength for frame in found]
