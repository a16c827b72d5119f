"""Camera files: written for people, read back to the last bit, refused with the line that is wrong."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from stadimeter.config.camera_file import camera_model_from_table, load_camera_model, save_camera_model
from stadimeter.config.toml_source import camera_table
from stadimeter.core.camera_model import UNKNOWN_EDGE_BIAS_SIGMA_PX, CameraModel, LensUncertainty, Provenance
from stadimeter.core.frame import Optics
from stadimeter.errors import ConfigError

MODEL = CameraModel(
    width_px=600,
    height_px=800,
    fx_px=672.4445773839064,
    fy_px=670.1,
    cx_px=299.5,
    cy_px=401.25,
    distortion=(-0.28, 0.07, 1e-4, -2e-5, 0.0),
    tone_curve="linear",
    edge_bias_px=-0.125,
    edge_bias_sigma_px=0.0625,
    focal_relative_sigma=0.0123,
    subsampling="4:2:2",
    optics=Optics(
        sensor="imx708",
        sensor_size_px=(2304, 1296),
        crop_px=(0, 0, 4608, 2592),
        lens_position_dpt=0.8,
        upside_down=True,
    ),
    uncertainty=LensUncertainty(sigmas=(0.5,) * 9, correlations=tuple(number / 300 for number in range(36))),
    provenance=Provenance(
        method="one picture at a known distance",
        date="2026-01-31",
        notes=("2ft.png: P = 238.16 px", 'a "quoted" \\ name\twith ½ and \x7f'),
    ),
)
WRITTEN = """\
# by hand
width_px = 640
height_px = 480
fx_px = 600.0
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "camera.toml"


def test_what_was_saved_is_read_back_to_the_last_bit(file: Path) -> None:
    save_camera_model(file, MODEL)
    assert load_camera_model(file) == MODEL


def test_the_name_of_a_picture_that_is_no_text_is_written_as_far_as_it_is(file: Path) -> None:
    notes = Provenance(notes=("b\udce4d.png: P = 238.16 px",))
    save_camera_model(file, replace(MODEL, provenance=notes))
    assert load_camera_model(file).provenance.notes == ("b?d.png: P = 238.16 px",)


@pytest.mark.parametrize(
    ("stated", "sigma_px"), [("", 0.1), ("edge_bias_px = 0.2", 0.1), ("edge_bias_sigma_px = 0", 0.0)]
)
def test_a_file_that_does_not_say_how_well_its_edge_bias_is_known_is_not_sure_of_it(
    file: Path, stated: str, sigma_px: float
) -> None:
    file.write_text(f"{WRITTEN}{stated}\n")
    assert load_camera_model(file).edge_bias_sigma_px == sigma_px
    assert camera_model_from_table(tomllib.loads(WRITTEN)).edge_bias_sigma_px == 0.0


def test_a_short_file_has_square_pixels_and_the_axis_in_the_middle(file: Path) -> None:
    file.write_text(WRITTEN, encoding="utf-8")
    unknown = UNKNOWN_EDGE_BIAS_SIGMA_PX
    assert load_camera_model(file) == replace(
        CameraModel.with_focal_length(600.0, 640, 480), edge_bias_sigma_px=unknown
    )


NO_LENSES = [
    ("distortion = [0.1, 0.2]", "distortion has 2 coefficients"),
    ("distortion = [0.1, 0.2, nan, 0.0]", "nan"),
    ("distortion = [-0.9, 0.0, 0.0, 0.0]", "folds the picture"),
    ('tone_curve = "gamma"', "srgb"),
    ("edge_bias_px = inf", "inf"),
    ('subsampling = "4:1:1"', "4:2:0"),
    ("lens_sigmas = [1.0, 1.0]", "9 numbers"),
    ("optics.crop_px = [0, 0, 10, 10]", "optics.sensor"),
    ('optics = { sensor = "a", sensor_size_px = [1, 1], crop_px = [0, 0, 0, 10] }', "optics.crop_px"),
]


def test_what_is_no_lens_is_refused_in_words(file: Path, subtests: pytest.Subtests) -> None:
    for line, complaint in NO_LENSES:
        with subtests.test(line=line, complaint=complaint):
            file.write_text(WRITTEN + line + "\n", encoding="utf-8")
            with pytest.raises(ConfigError) as refused:
                load_camera_model(file)
            assert complaint in str(refused.value).replace("infinity", "inf")


def test_a_date_may_stand_without_quotes(file: Path) -> None:
    file.write_text(WRITTEN + "date = 2026-01-31\n", encoding="utf-8")
    assert load_camera_model(file).provenance.date == "2026-01-31"


@pytest.mark.parametrize("place", ["missing/camera.toml", "folder"])
def test_where_it_cannot_be_written_nothing_is_left(tmp_path: Path, place: str) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(ConfigError, match="the camera file cannot be written") as caught:
        save_camera_model(tmp_path / place, MODEL)
    assert caught.value.problems[0].file == str(tmp_path / place)
    assert [each.name for each in tmp_path.rglob("*")] == ["folder"]


WRONG_LINES = [
    (WRITTEN + "fx = 3\n", 5, "fx", "unknown key 'fx'"),
    (WRITTEN + "fy_pix = 600\n", 5, "fy_pix", "unknown key 'fy_pix'"),
    (WRITTEN + "cx_px = nan\n", 5, "cx_px", "nan is not a finite number"),
    (WRITTEN + "focal_relative_sigma = -0.1\n", 5, "focal_relative_sigma", "-0.1 is below 0"),
    (WRITTEN + 'notes = "one"\n', 5, "notes", "'one' is not a list"),
    (WRITTEN.replace("600.0", '"600"x'), 4, "", "this is not valid TOML"),
    (WRITTEN.replace("640", "640.5"), 2, "width_px", "640.5 is not a whole number"),
    (WRITTEN.replace("fx_px", "fy_px"), 0, "fx_px", "'fx_px' is missing"),
    ("", 0, "width_px", "'width_px' is missing"),
]


def test_what_is_wrong_is_said_with_its_line(file: Path, subtests: pytest.Subtests) -> None:
    for text, line, key, said in WRONG_LINES:
        with subtests.test(text=text, line=line):
            file.write_text(text, encoding="utf-8")
            with pytest.raises(ConfigError) as caught:
                load_camera_model(file)
            problem = next(each for each in caught.value.problems if each.key == key)
            assert (problem.file, problem.line) == (str(file), line)
            assert said in problem.message


def test_every_mistake_is_listed(file: Path) -> None:
    file.write_text("width_px = -1\nheight_px = 2\nfx_px = nan\nfocus = 1\n", encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_camera_model(file)
    assert [problem.line for problem in caught.value.problems] == [1, 3, 4]


def test_a_file_that_is_missing_says_how_to_make_one(file: Path) -> None:
    with pytest.raises(ConfigError, match=r"there is no such file.*calibrate distance"):
        load_camera_model(file)


def test_a_table_of_a_configuration_holds_the_same_keys() -> None:
    table = {"width_px": 640, "height_px": 480, "fx_px": 600.0}
    assert camera_model_from_table(table) == CameraModel.with_focal_length(600.0, 640, 480)
    assert camera_model_from_table({**table, "fx_px": 600}).fx_px == 600.0
    with pytest.raises(ConfigError) as caught:
        camera_model_from_table({**table, "fx_px": "600"})
    (problem,) = caught.value.problems
    assert (problem.file, problem.line, problem.key) == ("", 0, "fx_px")


# Cameras as people name them in one line: a device, an address, or a driver with options.


@pytest.mark.parametrize(
    ("text", "table"),
    [
        ("0", {"driver": "opencv", "device": 0}),
        ("/dev/video2,exposure=10ms", {"driver": "opencv", "device": "/dev/video2", "exposure": "10ms"}),
        ("http://pi.local/s?a=1,latency=200ms", {"device": "http://pi.local/s?a=1", "latency": "200ms"}),
        ("picamera2,colour_gains=[2.1,1.5],gain=4", {"driver": "picamera2", "colour_gains": [2.1, 1.5], "gain": 4}),
        ("images,paths=['a.png', 'b.png']", {"driver": "images", "paths": ["a.png", "b.png"]}),
    ],
)
def test_a_camera_in_one_line_is_the_table_that_a_configuration_would_have(text: str, table: dict[str, Any]) -> None:
    assert camera_table(text) == {"driver": "opencv", **table}
