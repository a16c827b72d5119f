"""Certifying before a camera whose pictures come at their own pace: the frame rate, the latency and the view behind."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from stadimeter.app.capture import Capture
from stadimeter.app.certificate import load_certificate
from stadimeter.app.mounting import lens_figures, load_reference
from stadimeter.config.camera_file import load_camera_model, save_camera_model
from stadimeter.config.loader import load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Frame, Image
from stadimeter.ranging.site_fit import Placement
from stadimeter.workbench.certificate import session as session_module
from stadimeter.workbench.certificate.session import MIN_FRAMES, SiteSession
from stadimeter.workbench.frame_source import Source
from stadimeter.workbench.server.operations import Desk, find_operation
from support.scenes.ball import BallTarget
from support.scenes.render import render
from support.scenes.room import RoomBackdrop
from support.scenes.scene import Scene
from support.v4l2_double import V4l2Double

pytestmark = pytest.mark.vision

CONFIGURATION = """
[camera]
driver = "opencv"
device = "{device}"
model = "camera.toml"

[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "20,60,40:50,255,255"

[actuators.motor]
driver = "simulated"

[rules.near]
actuator = "motor"
when = {{ below = "1 m" }}
"""
LENS = CameraModel.with_focal_length(600.0, 640, 480)
TAKEN_S = 1.0  # four pictures a tenth of a second apart make a view, on a busy machine too

# A camera of 30 Hz of which every third picture is asked for, each this old when it has been measured.
APART_S, EVERY, AGE_S = 0.1, 3, 100.0


def ball_at(near_side_m: float) -> Image:
    ball = BallTarget(position_m=(0.0, 0.0, near_side_m + 0.1), diameter_m=0.2)
    return render(Scene(camera=LENS, target=ball, seed=1, backdrop=RoomBackdrop())).image


class OldPictures(Capture):
    """A camera whose pictures have stamps that are known."""

    def __init__(self, image: Image) -> None:
        self._image, self._count, self._began_s = image, 0, time.monotonic() - AGE_S

    def open(self) -> None: ...

    def close(self) -> None: ...

    def remarks(self) -> tuple[str, ...]:
        return ()

    def not_for_motion(self) -> str:
        return ""

    def latest(self, timeout_s: float) -> Frame:
        self._count += 1
        return Frame(self._image, self._began_s + APART_S * self._count, EVERY * self._count)


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """Return the configuration of a live camera, whose focal length is stated 4 % too long."""
    save_camera_model(tmp_path / "camera.toml", CameraModel.with_focal_length(624.0, 640, 480))
    (tmp_path / "site.toml").write_text(CONFIGURATION.format(device=tmp_path / "video0"))
    return tmp_path / "site.toml"


def take(site: Path, at_m: float, for_s: float = TAKEN_S) -> Placement:
    """Measure at a distance in a session of its own, as each request of the page has."""
    return SiteSession(load_configuration(site)).take(at_m, for_s=for_s)


def test_the_frame_rate_is_the_cameras_and_the_latency_is_the_age_of_a_measured_picture(
    site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = OldPictures(ball_at(1.0))
    monkeypatch.setattr(session_module, "source_beside_run", lambda *_: Source(capture=camera, is_live=True))
    placed = take(site, 1.0, for_s=APART_S * MIN_FRAMES)
    assert placed.rate_hz == pytest.approx(EVERY / APART_S)
    assert placed.latency_s is not None
    assert placed.latency_s > AGE_S - APART_S * 2 * MIN_FRAMES
    assert placed.frames == placed.found >= MIN_FRAMES


def measure_at_three(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = V4l2Double.plugged_in(site.parent / "video0", ball_at(0.6), monkeypatch)
    for at_m in (0.6, 1.0, 2.0):
        camera.show(ball_at(at_m))
        placed = take(site, at_m)
        assert placed.rate_hz is not None
        assert placed.rate_hz > 0
        assert placed.latency_s is not None
        assert placed.latency_s > 0


@pytest.mark.long
def test_a_live_camera_is_certified_on_the_page_its_view_is_saved_and_a_correction_keeps_that_view_valid(
    site: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure_at_three(site, monkeypatch)
    assert load_reference(site) is None, "nothing is saved before it is finished"
    desk = Desk(configuration=site)
    words = find_operation("certifying.finish")(desk, {}).data["certificate"]["words"]
    assert "View of the camera, by which a run tells whether it was moved: saved as site.mounting." in words
    made, saved = load_certificate(site), load_reference(site)
    assert made is not None
    assert saved is not None
    assert made.view == b""
    assert [row for row in made.placements if not row.rate_hz] == []
    corrected = find_operation("certifying.finish")(desk, {"correct": True}).data["certificate"]
    assert "it was moved: saved as site.mounting." in " ".join(corrected["words"])
    lens, again = load_camera_model(site.parent / "camera.toml"), load_reference(site)
    assert lens.fx_px == pytest.approx(600, rel=0.01)
    assert again is not None
    assert again.lens == pytest.approx(lens_figures(lens))
    then, now = saved.views[0].features["place"], again.views[0].features["place"]
    assert lens.project(now) == pytest.approx(CameraModel.with_focal_length(624.0, 640, 480).project(then))
