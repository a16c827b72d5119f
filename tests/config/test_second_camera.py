"""Two cameras as they are written, and what is wrong with them."""

import math

import pytest

from stadimeter.config.describe import describe
from stadimeter.config.loader import load_configuration
from stadimeter.config.schema import configuration_schema
from stadimeter.errors import ConfigError
from support.two_cameras import BESIDE, SECTIONS, load


def problems(folder, **lines):
    with pytest.raises(ConfigError) as raised:
        load(folder, **lines)
    return [(problem.key, problem.code, problem.message) for problem in raised.value.problems]


@pytest.mark.long
def test_the_lens_of_the_camera_is_that_of_the_stereo_file(tmp_path):
    configuration = load(tmp_path)
    assert configuration.rig == BESIDE
    assert configuration.camera_model == configuration.rig.left
    assert configuration.second_camera.driver == "simulated"
    assert "and from 0.12 m (0.4 ft) beside it with simulated." in describe(configuration)[0]
    assert "stereo" in configuration_schema()["$defs"]["second_camera.opencv"]["required"]


def test_a_camera_model_beside_a_stereo_file_is_refused(tmp_path):
    model = "model = { width_px = 640, height_px = 480, fx_px = 600.0, fy_px = 600.0, cx_px = 319.5, cy_px = 239.5 }"
    message = "the stereo file of [second_camera] has the lenses of both cameras"
    assert problems(tmp_path, camera=model) == [("camera.model", "used-twice", message)]


def test_one_device_twice_is_noticed(tmp_path):
    found = problems(
        tmp_path, camera='=driver = "simulated"', second_camera='=driver = "simulated"\nstereo = "stereo.toml"'
    )
    assert ("second_camera.driver", "used-twice", "this is the first camera once more") in found


def test_a_stereo_file_that_is_missing_or_wrong_is_said(tmp_path):
    usual = SECTIONS["second_camera"]
    ((key, _, message),) = problems(tmp_path, second_camera="=" + usual.replace("stereo.toml", "none.toml"))
    assert key == "second_camera.stereo"
    assert "none.toml" in message
    ((key, code, _),) = problems(tmp_path, second_camera="=" + usual.partition("\nstereo")[0])
    assert (key, code) == ("second_camera.stereo", "missing-key")
    load(tmp_path)
    text = (tmp_path / "stereo.toml").read_text()
    (tmp_path / "other.toml").write_text(text.replace("place_m = [0.12,", "place_m = [0.0,"))
    ((key, _, message),) = problems(tmp_path, second_camera="=" + usual.replace("stereo.toml", "other.toml"))
    assert "the two cameras are in one place" in message


@pytest.mark.parametrize(
    "size",
    [
        'detector = "ball"\ndiameter = "7 cm"\ntolerance = "unknown"',
        'detector = "tag"\nside = "7 cm"\ntolerance = "unknown"',
        'detector = "object"\nheight = "1.7 m ± unknown"',
    ],
)
def test_an_unknown_size_needs_a_second_camera_or_the_floor(tmp_path, size):
    configuration = load(tmp_path, targets_ball=f"={size}")
    (target,) = configuration.targets
    sigma = getattr(target.options, "tolerance", None) or target.options.height.sigma_m
    assert math.isinf(sigma)
    one = '[camera]\ndriver = "opencv"\ndevice = 0\n[camera.model]\nwidth_px = 640\nheight_px = 480\nfx_px = 600.0\n'
    one += "fy_px = 600.0\ncx_px = 319.5\ncy_px = 239.5\n"

    path = tmp_path / "one.toml"
    path.write_text(f"{one}[targets.ball]\n{size}\n")
    with pytest.raises(ConfigError, match="one camera measures no distance of a thing whose size is not known"):
        load_configuration(path)
    path.write_text(
        one.replace("device = 0", 'device = 0\nheight = "30 cm"') + f"[targets.ball]\n{size}\non_floor = true\n"
    )
    assert load_configuration(path).footings
