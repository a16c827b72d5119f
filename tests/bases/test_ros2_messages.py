from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.bases.protocol import Motion
from stadimeter.bases.rosbridge import POSE_TYPE, battery_from_json, pose_json, target_pose, type_name, velocity_json
from stadimeter.core.measurement import Track, TrackStatus

pytest.importorskip("rosbags", reason="the definitions of ROS 2's messages, of the group dev")

from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)


@pytest.mark.parametrize("message", ["Twist", "TwistStamped"])
def test_json_has_the_fields_of_the_type_and_no_others(message: str) -> None:
    fields = velocity_json(Motion(linear_mps=0.3, angular_radps=-0.5), message, "base_link")
    names = [name for name, _ in STORE.fielddefs[type_name(message)][1]]
    assert [*fields] == names
    twist = fields if message == "Twist" else fields["twist"]
    assert (twist["linear"]["x"], twist["angular"]["z"]) == (0.3, -0.5)


def track(distance_m: float = 2.0, sigma_m: float = 0.1, bearing_rad: float = 0.3, elevation_rad: float = 0.2) -> Track:
    return Track(
        target="ball",
        status=TrackStatus.TRACKING,
        distance_m=distance_m,
        sigma_m=sigma_m,
        bearing_rad=bearing_rad,
        elevation_rad=elevation_rad,
    )


@given(
    distance_m=st.floats(0.05, 50),
    sigma_m=st.floats(1e-3, 5),
    bearing_rad=st.floats(-1, 1),
    elevation_rad=st.floats(-1, 1),
    bearing_sigma_rad=st.floats(1e-4, 0.2),
)
def test_a_pose_varies_with_the_distance_along_the_line_of_sight_and_with_the_direction_across_it(
    distance_m: float, sigma_m: float, bearing_rad: float, elevation_rad: float, bearing_sigma_rad: float
) -> None:
    pose = target_pose(track(distance_m, sigma_m, bearing_rad, elevation_rad), 0.0, bearing_sigma_rad)
    place = np.array(pose.position_m)
    assert np.linalg.norm(place) == pytest.approx(distance_m)
    assert math.atan2(-place[1], place[0]) == pytest.approx(bearing_rad)
    assert math.asin(place[2] / distance_m) == pytest.approx(elevation_rad)
    covariance = np.array(pose.covariance).reshape(6, 6)[:3, :3]
    sight = place / distance_m
    assert sight @ covariance @ sight == pytest.approx(sigma_m**2)
    across_m2 = (distance_m * bearing_sigma_rad) ** 2
    for across in (np.cross(sight, (0, 0, 1)), np.cross(sight, np.cross(sight, (0, 0, 1)))):
        assert across @ covariance @ across / (across @ across) == pytest.approx(across_m2)


def test_a_pose_in_json_has_the_fields_of_the_type_and_no_others() -> None:
    fields = pose_json(target_pose(track(), 1.5, 0.01), "camera_link")
    assert [*fields] == [name for name, _ in STORE.fielddefs[POSE_TYPE][1]]
    assert [*fields["pose"]] == [name for name, _ in STORE.fielddefs["geometry_msgs/msg/PoseWithCovariance"][1]]
    assert fields["header"] == {"stamp": {"sec": 1, "nanosec": 500_000_000}, "frame_id": "camera_link"}
    assert len(fields["pose"]["covariance"]) == 36


@pytest.mark.parametrize("voltage", [None, math.nan, math.inf, "12 V", True])
def test_a_voltage_that_is_not_known_is_none(voltage: object) -> None:
    assert battery_from_json({"voltage": voltage}) is None
    assert battery_from_json({}) is None
