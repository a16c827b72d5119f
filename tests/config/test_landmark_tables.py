"""Tags of known places as they are written, and what is wrong with them."""

import math

import pytest

from stadimeter.app.control.reloading import needs_restart
from stadimeter.config.loader import load_configuration
from stadimeter.core.camera_pose import Landmarks, PlacedTag
from stadimeter.errors import ConfigError
from support.simulated_run import SIMULATED_BALL

GARDEN = """
[landmarks]
tag_size = "10 cm"

[[landmarks.tags]]
id = 3
at = ["2 m", "0 m", "0.5 m"]
facing = "90 deg"

[[landmarks.tags]]
id = 7
at = ["6 m", "-1.5 m", "0 m"]
facing = "180 deg"
tilt = "90 deg"
size = "20 cm"
"""


@pytest.fixture
def load(tmp_path):
    def load(text):
        path = tmp_path / "mower.toml"
        path.write_text(f"{SIMULATED_BALL}\n[world]\n{text}")
        return load_configuration(path)

    return load


def test_tags_are_read_as_they_are_written(load):
    assert load(GARDEN).landmarks == Landmarks(
        tags=(
            PlacedTag(number=3, side_m=0.1, position_m=(2.0, 0.0, 0.5), facing_rad=math.pi / 2),
            PlacedTag(number=7, side_m=0.2, position_m=(6.0, -1.5, 0.0), facing_rad=math.pi, tilt_rad=math.pi / 2),
        )
    )


def test_how_well_tags_were_placed_and_printed_is_read(load):
    how = 'tag_size = "10 cm"\nplace_sigma = "1 cm"\nfacing_sigma = "1 deg"\ntolerance = "0.2 mm"'
    landmarks = load(GARDEN.replace('tag_size = "10 cm"', how)).landmarks
    assert (landmarks.place_sigma_m, landmarks.size_relative_sigma) == pytest.approx((0.01, 0.002))
    assert landmarks.facing_sigma_rad == pytest.approx(math.radians(1))


def test_a_change_of_a_place_asks_for_a_restart(load):
    assert needs_restart(load(GARDEN), load(GARDEN.replace('"0.5 m"', '"0.6 m"'))) == ("[landmarks]",)


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        ("id = 7", "id = 3", "id = 3", "tag 3 is listed twice"),
        ('"-1.5 m"', '"-1.5"', "at =", "'-1.5' has no unit"),
        ('["6 m", "-1.5 m", "0 m"]', '["6 m", "-1.5 m"]', "at =", "fewer than 3 entries"),
        ("id = 7", "id = 587", "id =", "587 is not in apriltag-36h11"),
        ('tag_size = "10 cm"', 'tag_size = "10 cm"\nfamily = "36h12"', "family =", "36h11"),
        ('facing = "90 deg"\n', "", "", "'facing' is missing"),
        ('facing = "90 deg"', 'facing = "90 deg"\nyaw = "1 deg"', "yaw", "unknown key 'yaw'"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(load, old, new, line, says):
    text = GARDEN.replace(old, new)
    with pytest.raises(ConfigError) as caught:
        load(text)
    (problem,) = caught.value.problems
    assert says in f"{problem.message} {problem.hint}"
    assert problem.key.startswith("landmarks")
    lines = f"{SIMULATED_BALL}\n[world]\n{text}".splitlines()
    assert line in lines[problem.line - 1]
