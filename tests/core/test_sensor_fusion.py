"""What the camera and a range sensor say of one target is joined by variances, or the sensor disagrees."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.core.decision import EventKind
from stadimeter.core.measurement import Measurement, MeasurementStatus
from stadimeter.core.sensor_fusion import MAX_APART_S, SensorPair, fuse, step_disagreements

PAIR = SensorPair(sensor="front", target="ball", half_beam_rad=0.13, radius_m=0.1)
sigmas = st.floats(1e-3, 0.5)
distances = st.floats(0.2, 5.0)


def measured(target, distance_m, sigma_m, *, bearing_rad=0.0, at_s=1.0):
    return Measurement(
        target=target,
        status=MeasurementStatus.MEASURED,
        captured_at_s=at_s,
        distance_m=distance_m,
        depth_m=distance_m * math.cos(bearing_rad),
        sigma_m=sigma_m,
        noise_m=sigma_m / 2,
        bearing_rad=bearing_rad,
        elevation_rad=0.0,
    )


def fused(ball, front, pair=PAIR):
    return fuse({"ball": ball, "front": front}, [pair])


@given(distance_m=distances, sigma_m=sigmas, echo_sigma_m=sigmas, apart_sigmas=st.floats(-4.9, 4.9))
def test_the_joint_distance_lies_between_both_and_is_surer_than_either(distance_m, sigma_m, echo_sigma_m, apart_sigmas):
    echo_m = distance_m + apart_sigmas * math.hypot(sigma_m, echo_sigma_m)
    joint, compared = fused(measured("ball", distance_m, sigma_m), measured("front", echo_m - 0.1, echo_sigma_m))
    low, high = sorted((distance_m, echo_m))
    assert low - 1e-9 <= joint["ball"].distance_m <= high + 1e-9
    assert joint["ball"].sigma_m < min(sigma_m, echo_sigma_m)
    assert 1 / joint["ball"].sigma_m ** 2 == pytest.approx(1 / sigma_m**2 + 1 / echo_sigma_m**2)
    assert joint["ball"].depth_m / joint["ball"].distance_m == pytest.approx(1.0)
    assert compared == {"front": ""}


def test_beyond_five_standard_deviations_the_camera_stands_and_the_sensor_disagrees():
    ball = measured("ball", 1.0, 0.03)
    joint, compared = fused(ball, measured("front", 0.5, 0.04))
    assert joint["ball"] is ball
    assert "8 σ" in compared["front"]


@pytest.mark.parametrize(
    "front",
    [
        measured("front", 0.9, 0.01, bearing_rad=0.2),
        measured("front", 0.9, 0.01, at_s=1.0 - 1.1 * MAX_APART_S),
        Measurement(target="front", status=MeasurementStatus.NOT_FOUND, captured_at_s=1.0),
        measured("front", math.nan, 0.01),
        measured("front", 0.9, 0.0),
    ],
    ids=["beside the beam", "too old", "nothing seen", "no number", "no sigma"],
)
def test_what_is_not_of_the_same_place_and_moment_is_not_joined(front):
    ball = measured("ball", 1.0, 0.03)
    joint, compared = fused(ball, front)
    assert joint["ball"] is ball
    assert compared == {}


def test_a_disagreement_is_reported_when_it_begins_and_when_it_ends():
    sensors, began = step_disagreements(frozenset(), {"front": "apart"}, 1.0)
    sensors, goes_on = step_disagreements(sensors, {"front": "apart"}, 2.0)
    sensors, not_seen = step_disagreements(sensors, {}, 3.0)
    sensors, ended = step_disagreements(sensors, {"front": ""}, 4.0)
    assert [event.kind for event in began] == [EventKind.FAULT]
    assert [event.kind for event in ended] == [EventKind.FAULT_CLEARED]
    assert (goes_on, not_seen, sensors) == ((), (), frozenset())
