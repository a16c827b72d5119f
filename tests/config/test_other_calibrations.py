"""Calibration files of other programs say the same as a camera file, or are named as what they are."""

import pytest

from stadimeter.config.camera_file import load_camera_model
from stadimeter.errors import ConfigError

OPENCV = """%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 6.1e+02, 0., 321.5, 0., 612.5, 240.25, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ 0.1, -0.2, 0.001, 0.0005,
       0.03 ]
avg_reprojection_error: 0.2
"""
OPENCV_XML = """<?xml version="1.0"?>
<opencv_storage>
<image_width>640</image_width>
<image_height>480</image_height>
<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
  <data>610. 0. 321.5 0. 612.5 240.25 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix"><rows>1</rows><cols>5</cols><dt>d</dt>
  <data>0.1 -0.2 0.001 0.0005 0.03</data></distortion_coefficients>
</opencv_storage>
"""
ROS = """image_width: 640
image_height: 480
camera_name: head
camera_matrix: {rows: 3, cols: 3, data: [610.0, 0.0, 321.5, 0.0, 612.5, 240.25, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [0.1, -0.2, 0.001, 0.0005, 0.03]
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
"""
KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [610.0, 612.5, 321.5, 240.25]
  distortion_model: radtan
  distortion_coeffs: [0.1, -0.2, 0.001, 0.0005]
  resolution: [640, 480]
"""
PHOTON = """{"resolution": {"width": 640.0, "height": 480.0}, "cameraIntrinsics": {"rows": 3, "cols": 3, "type": 6,
 "data": [610.0, 0, 321.5, 0, 612.5, 240.25, 0, 0, 1]}, "distCoeffs": {"rows": 1, "cols": 8, "type": 6,
 "data": [0.1, -0.2, 0.001, 0.0005, 0.03, 0, 0, 0]}, "observations": []}
"""


@pytest.mark.parametrize(
    ("name", "text", "coefficients"),
    [
        ("opencv.yml", OPENCV, 5),
        ("opencv.xml", OPENCV_XML, 5),
        ("ros.yaml", ROS, 5),
        ("kalibr.yaml", KALIBR, 4),
        ("omnivision.yaml", "board_width: 9\nboard_height: 6\n" + ROS.replace("head", "omnivision_ov5647"), 5),
        ("photon.json", PHOTON, 5),
        ("distance.yaml", "distance: 1.5\n# camera_matrix: of the left\nk: 5\n" + ROS, 5),
        ("wrapped.json", f'{{"intrinsics": {PHOTON}}}', 5),
        ("photon-2022.json", PHOTON.replace("distCoeffs", "cameraExtrinsics"), 5),
        (
            "from-python.json",
            (
                '{"mtx": [[610, 0, 321.5], [0, 612.5, 240.25], [0, 0, 1]], "dist": [[0.1, -0.2, 0.001,'
                ' 0.0005, 0.03]], "image_size": [640, 480]}'
            ),
            5,
        ),
        (
            "from-python.yaml",
            (
                "image_width: 640\nimage_height: 480\ncamera_matrix:\n- - 610.0\n  - 0.0\n  - 321.5\n"
                "- - 0.0\n  - 612.5\n  - 240.25\n- - 0.0\n  - 0.0\n  - 1.0\ndist_coeff:\n- - 0.1\n  - -0.2\n  - 0.001\n"
                "  - 0.0005\n  - 0.03\n"
            ),
            5,
        ),
        (
            "echo.txt",
            (
                "height: 480\nwidth: 640\ndistortion_model: plumb_bob\nd:\n- 0.1\n- -0.2\n- 0.001\n- 0.0005\n"
                "- 0.03\nk: [610.0, 0.0, 321.5, 0.0, 612.5, 240.25, 0.0, 0.0, 1.0]\nroi:\n  x_offset: 0\n"
            ),
            5,
        ),
    ],
)
def test_a_calibration_of_another_program_is_read(tmp_path, name, text, coefficients):
    path = tmp_path / name
    path.write_text(text)
    model = load_camera_model(path)
    assert (model.width_px, model.height_px) == (640, 480)
    assert (model.fx_px, model.fy_px, model.cx_px, model.cy_px) == (610.0, 612.5, 321.5, 240.25)
    assert tuple(model.distortion) == (0.1, -0.2, 0.001, 0.0005, 0.03)[:coefficients]
    assert model.focal_relative_sigma > 0
    assert model.edge_bias_sigma_px > 0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (PHOTON.replace("0.03, 0, 0, 0", "0.03, 0.1, 0, 0"), "8 coefficients"),
        (ROS.replace("plumb_bob", "equidistant"), "fisheye"),
        (KALIBR.replace("pinhole", "omni"), "fisheye"),
        (KALIBR.replace("radtan", "equi"), "fisheye"),
        (KALIBR + KALIBR.replace("cam0", "cam1").replace("610", "600"), "several cameras"),
        (KALIBR.replace("612.5, ", ""), "no camera matrix"),
        (OPENCV.replace("image_width: 640\n", ""), "how wide"),
        (OPENCV + "fisheye_model: 1\n", "fisheye"),
        (OPENCV_XML.replace("<image_width>", "<fisheye_model>1</fisheye_model><image_width>"), "fisheye"),
        (ROS.replace("plumb_bob", "thin_prism_fisheye"), "fisheye"),
        (ROS + "roi: {x_offset: 100, y_offset: 0}\n", "part of the picture"),
        (f"[{PHOTON}, {PHOTON.replace('610', '600')}]", "several cameras or resolutions"),
        (ROS.replace("640", "320").replace("480", "240"), "is that the size of its pictures"),
        ('{"version": 2.0, "algorithms": [{"rpi.dpc": {}}]}', "tuning of libcamera"),
        ("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n1 PINHOLE 640 480 610 612 321 240\n", "COLMAP"),
        ("PK\x03\x04", "NumPy; write its numbers"),
        ("MATLAB 5.0 MAT-file", "MATLAB; write its numbers"),
        ('{"fx": 610}', "no camera matrix .*; write its numbers"),
    ],
)
def test_what_cannot_be_read_is_named(tmp_path, text, words):
    path = tmp_path / "other.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=f"calibration file of another program cannot be used: .*({words})"):
        load_camera_model(path)


@pytest.mark.parametrize(
    ("text", "key"), [(ROS.replace("[610.0", "[.nan"), "fx_px"), (PHOTON.replace("0.03", "NaN"), "4")]
)
def test_what_is_no_number_is_an_error_of_its_key(tmp_path, text, key):
    path = tmp_path / "other.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=f"{key}: nan is not a finite number"):
        load_camera_model(path)


def test_any_other_file_is_read_as_a_camera_file(tmp_path):
    path = tmp_path / "notes.yaml"
    path.write_text("width_px = 640\nheight_px = 480\nfx_px = 610.0\n")
    assert load_camera_model(path).fx_px == 610.0
