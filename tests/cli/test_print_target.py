"""The commands `print` and `wiring`."""

from __future__ import annotations

import json
import re
import subprocess
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from stadimeter.cli.calibrate import board_from_options
from stadimeter.cli.main import app
from stadimeter.config.camera_file import save_camera_model
from stadimeter.config.plugins import DETECTORS, load_driver
from stadimeter.core.camera_model import CameraModel
from stadimeter.ranging.board_calibration import BoardView
from support.programs import needs

# The commands `print`: what comes out of the printer has the size asked for, and is found by our detectors.

POINTS_PER_M = 72 / 0.0254
DPI = 150.0
PX_PER_M = DPI / 0.0254
FOCAL_PX = 2000.0
FINER = 4

Picture = NDArray[np.uint8]


def run(*arguments: str | Path) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["print", *map(str, arguments)])
    return done.exit_code, done.output


def content(pdf: Path) -> list[str]:
    """Return the operators of each page."""
    found = re.findall(rb"/Length (\d+) >>\nstream\n", pdf.read_bytes())
    streams = re.findall(rb"stream\n(.*?)\nendstream", pdf.read_bytes(), re.DOTALL)
    assert [len(each) for each in streams] == [int(length) for length in found]
    return [each.decode("cp1252") for each in streams]


def page_size(pdf: Path) -> tuple[float, float]:
    width, height = re.findall(rb"/MediaBox \[0 0 (\S+) (\S+)\]", pdf.read_bytes())[0]
    return float(width), float(height)


def rasterised(pdf: Path, page: int = 0) -> Picture:
    """Return a page's filled black rectangles and circles as a printer would put them on paper, `DPI` to the inch."""
    width, height = page_size(pdf)
    per_point = FINER * DPI / 72
    paper = np.full((round(height * per_point), round(width * per_point)), 255, np.uint8)
    for painted in re.findall(r"0 0 0 rg\n((?:.*\n)*?)f$", content(pdf)[page], re.MULTILINE):
        for path in painted.splitlines():
            numbers = np.array([float(each) for each in re.findall(r"-?\d+\.?\d*", path)])
            corners = _rectangle(numbers) if path.endswith("re") else _curve(numbers)
            on_paper = np.column_stack([corners[:, 0], height - corners[:, 1]]) * per_point - 0.5
            cv2.fillPoly(paper, [np.round(on_paper * 16).astype(np.int32)], 0, cv2.LINE_AA, 4)
    small = cv2.resize(paper, None, fx=1 / FINER, fy=1 / FINER, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(small, cv2.COLOR_GRAY2BGR), np.uint8)


def _rectangle(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, width, height = numbers
    return np.array([(x, y), (x + width, y), (x + width, y + height), (x, y + height)])


def _curve(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
    points = numbers.reshape(-1, 2)
    t = np.linspace(0, 1, 40)[:, np.newaxis]
    quarters = []
    for first in range(0, len(points) - 1, 3):
        p0, p1, p2, p3 = points[first : first + 4]
        quarters.append((1 - t) ** 3 * p0 + 3 * (1 - t) ** 2 * t * p1 + 3 * (1 - t) * t**2 * p2 + t**3 * p3)
    return np.concatenate(quarters)


def measured(tmp_path: Path, picture: Picture, *target: str) -> dict[str, object]:
    """Return what `measure` says of a flat picture that is seen from in front, where a metre has `PX_PER_M` pixels."""
    height, width = picture.shape[:2]
    model = CameraModel(
        width_px=width, height_px=height, fx_px=FOCAL_PX, fy_px=FOCAL_PX, cx_px=(width - 1) / 2, cy_px=(height - 1) / 2
    )
    save_camera_model(tmp_path / "camera.toml", model)
    cv2.imwrite(str(tmp_path / "page.png"), picture)
    arguments = ["measure", tmp_path / "page.png", "--camera", tmp_path / "camera.toml", "--json", *target]
    done = CliRunner().invoke(app, list(map(str, arguments)))
    return json.loads(done.stdout.splitlines()[0])


@pytest.mark.parametrize(("family", "paper"), [("36h11", "A4"), ("16h5", "letter"), ("aruco-original", "A4")])
def test_a_printed_tag_is_found_upright_with_its_number_and_its_size(tmp_path: Path, family: str, paper: str) -> None:
    pdf = tmp_path / "tag.pdf"
    assert run("tag", "8cm", "--family", family, "--id", "7", "--paper", paper, "-o", pdf)[0] == 0
    seen = measured(tmp_path, rasterised(pdf), "--tag", "8cm", "--family", family)
    assert seen["id"] == 7
    assert seen["depth_m"] == pytest.approx(FOCAL_PX / PX_PER_M, rel=2e-3)


def test_every_tag_of_several_pages_is_there(tmp_path: Path) -> None:
    pdf = tmp_path / "tags.pdf"
    run("tag", "5cm", "--id", "0-9", "--id", "20,22", "-o", pdf)
    seen = set()
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11))
    for page in range(len(content(pdf))):
        numbers = detector.detectMarkers(rasterised(pdf, page))[1]
        seen |= set(np.ravel(numbers).tolist())
    assert seen == {*range(10), 20, 22}


def test_a_printed_disc_is_found_with_its_size(tmp_path: Path) -> None:
    pdf = tmp_path / "disc.pdf"
    run("disc", "12cm", "-o", pdf)
    seen = measured(tmp_path, rasterised(pdf), "--disc", "12cm")
    assert seen["depth_m"] == pytest.approx(FOCAL_PX / PX_PER_M, rel=1e-3)


@pytest.mark.parametrize("options", [("9x6", None, "25mm", None, None), (None, "5x7", "35mm", "26mm", "4X4_50")])
def test_a_printed_board_has_its_corners_where_calibrate_board_takes_them_to_be(
    tmp_path: Path, options: tuple[str | None, str | None, str, str | None, str | None]
) -> None:
    names = ("--board", "--charuco", "--square", "--marker", "--dictionary")
    given = [word for name, value in zip(names, options, strict=True) if value for word in (name, value)]
    pdf = tmp_path / "board.pdf"
    assert run("board", *given, "-o", pdf)[0] == 0
    view = board_from_options(*options).find("page", rasterised(pdf))
    assert isinstance(view, BoardView), view
    on_paper_m = view.corners_px / PX_PER_M
    apart_m = np.linalg.norm(view.board_m[:, np.newaxis, :2] - view.board_m[np.newaxis, :, :2], axis=2)
    assert np.linalg.norm(on_paper_m[:, np.newaxis] - on_paper_m[np.newaxis], axis=2) == pytest.approx(
        apart_m, abs=3e-4
    )


def test_sizes_on_paper_are_exact(tmp_path: Path) -> None:
    pdf = tmp_path / "tag.pdf"
    run("tag", "8cm", "-o", pdf)
    assert page_size(pdf) == pytest.approx((210 * 72 / 25.4, 297 * 72 / 25.4), abs=1e-3)
    rectangles = np.array(
        [[float(each) for each in line.split()[:4]] for line in content(pdf)[0].splitlines() if line.endswith(" re")]
    )
    left, right = rectangles[:, 0].min(), (rectangles[:, 0] + rectangles[:, 2]).max()
    bottom, top = rectangles[:, 1].min(), (rectangles[:, 1] + rectangles[:, 3]).max()
    assert (right - left, top - bottom) == pytest.approx((0.08 * POINTS_PER_M, 0.08 * POINTS_PER_M), abs=1e-3)


def test_the_ruler_is_10_cm_and_4_in_long(tmp_path: Path) -> None:
    pdf = tmp_path / "tag.pdf"
    run("tag", "-o", pdf)
    ticks = [
        [float(each) for each in re.findall(r"-?\d+\.?\d*", line)]
        for line in content(pdf)[0].splitlines()
        if line.endswith("l S")
    ]
    upright = np.array([(x1, y2 - y1) for _, _, x1, y1, x2, y2 in ticks if x1 == x2])
    for is_above, length_m in ((True, 0.1), (False, 4 * 0.0254)):
        places = upright[(upright[:, 1] > 0) == is_above, 0]
        assert places.max() - places.min() == pytest.approx(length_m * POINTS_PER_M, abs=1e-3)


@needs("pdftoppm")
def test_another_program_reads_the_file_and_sees_the_same(tmp_path: Path) -> None:
    pdf = tmp_path / "disc.pdf"
    run("disc", "12cm", "-o", pdf)
    subprocess.run(["pdftoppm", "-r", str(DPI), "-png", pdf, tmp_path / "page"], check=True)
    picture = cv2.imread(str(tmp_path / "page-1.png"))
    assert measured(tmp_path, picture, "--disc", "12cm")["depth_m"] == pytest.approx(FOCAL_PX / PX_PER_M, rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("tag", "30cm"), "A4 has no room for it: make it smaller, or take --paper A2"),
        (("board", "--square", "40mm"), "A4 has no room for it: make it smaller, or take --paper A2"),
        (("tag", "--paper", "A9"), "--paper: 'A9' is no paper to print on"),
        (("tag", "--id", "9999"), "9999 is not in apriltag-36h11"),
        (("tag", "--id", "0-99999"), "200 at most"),
    ],
    ids=str,
)
def test_what_cannot_be_printed_says_what_can(tmp_path: Path, arguments: tuple[str, ...], words: str) -> None:
    code, shown = run(*arguments, "-o", tmp_path / "x.pdf")
    assert code == 2
    assert words in shown
    assert not (tmp_path / "x.pdf").exists()


@pytest.mark.parametrize("arguments", [("tag", "8cm", "--id", "3"), ("disc", "12cm")])
def test_the_lines_to_paste_are_a_target(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    _, shown = run(*arguments, "-o", tmp_path / "x.pdf")
    table = tomllib.loads(shown[shown.index("[targets") :])["targets"][arguments[0]]
    _, told = run(*arguments, "-o", tmp_path / "x.pdf", "--json")
    assert json.loads(told) == {
        "file": str(tmp_path / "x.pdf"),
        "pages": 1,
        "paper": "A4",
        "targets": {arguments[0]: table},
    }
    assert load_driver(DETECTORS, table.pop("detector")).model_validate(table)


def test_an_svg_has_its_true_size(tmp_path: Path) -> None:
    assert run("disc", "10cm", "-o", tmp_path / "disc.svg")[0] == 0
    text = (tmp_path / "disc.svg").read_text()
    assert 'width="210mm" height="297mm" viewBox="0 0 210 297"' in text
    assert 'r="50"' in text


# The command `wiring`.

CONFIGURATIONS = Path(__file__).parents[2] / "config"


def run_wiring(*arguments: str | Path) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["wiring", *map(str, arguments)])
    return done.exit_code, done.output


def test_it_draws_what_hangs_on_each_pin() -> None:
    code, shown = run_wiring(CONFIGURATIONS / "distance-alert.toml")
    assert code == 0
    assert "pin 12  GPIO 18 ──[220 ohm]" in shown
    assert "pin 16  GPIO 23 ──[220 ohm]" in shown


def test_a_program_is_told_what_hangs_on_each_pin() -> None:
    parts = json.loads(run_wiring(CONFIGURATIONS / "distance-alert.toml", "--json")[1])
    assert [(each["name"], each["gpio"], each["pin"]) for each in parts] == [("motor", 18, 12), ("buzzer", 23, 16)]


@pytest.mark.parametrize(("name", "begins"), [("wiring.svg", b"<svg"), ("wiring.pdf", b"%PDF-1.4")])
def test_it_draws_into_a_file(tmp_path: Path, name: str, begins: bytes) -> None:
    code, shown = run_wiring(CONFIGURATIONS / "distance-alert.toml", "-o", tmp_path / name)
    assert (code, shown) == (0, f"wrote {tmp_path / name}\n")
    assert (tmp_path / name).read_bytes().startswith(begins)


def test_another_kind_of_file_is_refused(tmp_path: Path) -> None:
    code, shown = run_wiring(CONFIGURATIONS / "distance-alert.toml", "-o", tmp_path / "wiring.png")
    assert code == 2
    assert ".pdf or .svg" in shown


def test_pins_that_the_pi_itself_uses_are_warned_of(tmp_path: Path) -> None:
    text = (CONFIGURATIONS / "distance-alert.toml").read_text().replace("pin = 18", "pin = 14")
    path = tmp_path / "alert.toml"
    path.write_text(text)
    code, shown = run_wiring(path)
    assert code == 0
    assert (
        "actuators.motor.pin: GPIO 14 is also for the serial console, which drives it high while the Pi boots" in shown
    )
