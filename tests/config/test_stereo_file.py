"""A stereo file holds two cameras as they were calibrated, and says what is wrong with it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from stadimeter.config.camera_file import load_stereo_rig, save_stereo_rig, stereo_file_text
from stadimeter.core.camera_model import Provenance
from stadimeter.core.frame import Frame, Optics
from stadimeter.core.stereo_rig import StereoRig
from stadimeter.errors import CalibrationError, ConfigError
from stadimeter.ranging.stereo import straight_ahead_share
from support.stereo import calibrate_pairs, drawn_pairs, true_rig

OPTICS = Optics(sensor="imx708", sensor_size_px=(2304, 1296), crop_px=(0, 0, 4608, 2592), lens_position_dpt=1.0)


@pytest.fixture(scope="module")
def rig() -> StereoRig:
    made = calibrate_pairs(drawn_pairs(true_rig(6), 6), 0.002).rig
    left = replace(made.left, optics=OPTICS, tone_curve="linear")
    return replace(made, left=left, provenance=Provenance(method='13 "pairs"', date="2026-01-31", notes=("a: 0.1 px",)))


@pytest.fixture
def file(rig: StereoRig, tmp_path: Path) -> Path:
    save_stereo_rig(tmp_path / "stereo.toml", rig)
    return tmp_path / "stereo.toml"


def frame(width_px: int, height_px: int, optics: Optics | None = None) -> Frame:
    return Frame(np.zeros((height_px, width_px, 3), np.uint8), 0.0, 0, optics=optics)


def test_what_is_written_is_read_again(rig: StereoRig, file: Path) -> None:
    again = load_stereo_rig(file)
    assert (again.turn_rad, again.place_m, again.provenance) == (rig.turn_rad, rig.place_m, rig.provenance)
    for one, other in ((again.left, rig.left), (again.right, rig.right)):
        assert replace(one, uncertainty=None, focal_relative_sigma=0.0) == replace(
            other, uncertainty=None, focal_relative_sigma=0.0, provenance=one.provenance
        )
        assert one.focal_relative_sigma == pytest.approx(other.focal_relative_sigma, rel=1e-6)
        assert one.uncertainty.sigmas == pytest.approx(other.uncertainty.sigmas, rel=1e-4)
    assert np.sqrt(np.diag(again.covariance)) == pytest.approx(np.sqrt(np.diag(rig.covariance)), rel=1e-6)


@pytest.mark.parametrize("away_m", [0.5, 3.0])
def test_figures_that_nearly_cancel_survive_the_file(rig: StereoRig, file: Path, away_m: float) -> None:
    again = straight_ahead_share(load_stereo_rig(file), away_m)
    assert again == pytest.approx(straight_ahead_share(rig, away_m), rel=1e-3)


def test_a_file_of_one_camera_is_not_one_of_two(tmp_path: Path) -> None:
    (tmp_path / "camera.toml").write_text("width_px = 640\nheight_px = 480\nfx_px = 600.0\n")
    with pytest.raises(ConfigError, match="a camera file, of one camera"):
        load_stereo_rig(tmp_path / "camera.toml")


@pytest.mark.parametrize(
    ("pattern", "instead", "said"),
    [
        (r"^place_m = .*$", "place_m = [0.0, 0.0, 0.0]", r"place_m: the two cameras are in one place"),
        (r"^place_m = .*$", "place_m = [0.1, 0.0]", r":\d+: place_m"),
        (r"^place_m = .*$", "", "'place_m' is missing"),
        (r"^turn_rad = .*$", "turn_rad = [400.0, 0.0, 0.0]", r":\d+: turn_rad\.0: 400\.0 is above 3\.15"),
        (r"^sigmas = \[", "sigmas = [-", r"sigmas\.0: -\d.* is below 0"),
        (r"^sigmas = .*$", "sigmas = [1.0]", "sigmas: .*a list of fewer than 24 entries"),
        (r"^\[left\]$", "[left]\nfocal = 3", "unknown key 'focal'"),
        (r"^\[right\]$", "[rigth]", "unknown key 'rigth'"),
        (r"^fx_px = .*$", "fx_px = 4.0", "focal length fx_px = 4 is not that of a lens"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(file: Path, pattern: str, instead: str, said: str) -> None:
    file.write_text(re.sub(pattern, instead, file.read_text(), count=1, flags=re.MULTILINE))
    with pytest.raises(ConfigError, match=said):
        load_stereo_rig(file)


def test_correlations_that_contradict_each_other_are_refused(rig: StereoRig, tmp_path: Path) -> None:
    text = stereo_file_text(rig)
    start, _, rest = text.partition("correlations = [\n")
    _, _, others = rest.partition("\n")
    opposite = ", ".join("1.0" if index % 2 else "-1.0" for index in range(23))
    (tmp_path / "wrong.toml").write_text(f"{start}correlations = [\n    {opposite},\n{others}")
    with pytest.raises(ConfigError, match="correlations contradict each other"):
        load_stereo_rig(tmp_path / "wrong.toml")


def test_pictures_of_twice_the_size_have_twice_the_uncertainty_in_pixels(rig: StereoRig) -> None:
    larger = replace(rig, left=replace(rig.left, optics=None)).for_frames(frame(1280, 960), frame(640, 480))
    assert larger.left.fx_px == pytest.approx(2 * rig.left.fx_px)
    assert larger.right.fx_px == rig.right.fx_px
    assert larger.covariance[0, 0] == pytest.approx(4 * rig.covariance[0, 0])
    assert larger.covariance[0, 9] == pytest.approx(2 * rig.covariance[0, 9])
    assert straight_ahead_share(larger, 2.0) == pytest.approx(straight_ahead_share(rig, 2.0), rel=1e-6)


def test_pictures_of_another_camera_are_refused_with_the_side(rig: StereoRig) -> None:
    with pytest.raises(CalibrationError, match=r"the right camera of the stereo file: .*another aspect"):
        rig.for_frames(frame(640, 480), frame(1280, 720))
    with pytest.raises(CalibrationError, match=r"the left camera of the stereo file: .*for the sensor imx708"):
        rig.for_frames(frame(640, 480, replace(OPTICS, sensor="imx219")), frame(640, 480))
