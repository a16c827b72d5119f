"""Certifying a site: distances one after the other, kept after each, and a certificate with its page from all."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.app.certificate import load_certificate
from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.app.mounting import lens_figures, load_reference
from stadimeter.app.places import PLACEMENTS
from stadimeter.config.camera_file import load_camera_model, save_camera_model
from stadimeter.config.loader import DEMONSTRATION, load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.core.frame import Image
from stadimeter.errors import ConfigError
from stadimeter.ranging.site_fit import Placement
from stadimeter.workbench.server.operations import Desk, find_operation
from stadimeter.workbench.site import SiteSession
from support.scenes.ball import BallTarget
from support.scenes.render import render
from support.scenes.room import RoomBackdrop
from support.scenes.scene import Scene
from support.simulated_run import LENS
from support.v4l2_double import V4l2Double

pytestmark = pytest.mark.vision


CAMERA = f"""
[camera]
driver = "simulated"
{LENS}"""
ROOM = """
[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "29,86,6:64,255,255"

[actuators.motor]
driver = "simulated"

[rules.near]
actuator = "motor"
when = { below = "1 m" }

[rules.far]
actuator = "motor"
ramp = { from = "2 m", to = "4 m" }

[world]
ball_diameter = "20 cm"
camera_height = "12 cm"
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
"""
QUICK_S = 0.1
PLACES_M = (0.5, 1.0, 2.0, 4.0)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "site.toml").write_text(CAMERA + ROOM)
    return tmp_path / "site.toml"


@pytest.fixture(scope="module")
def placements(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return what is kept of four distances."""
    path = tmp_path_factory.mktemp("measured") / "site.toml"
    path.write_text(CAMERA + ROOM)
    session = session_of(path)
    for at_m in PLACES_M:
        session.take(at_m, for_s=QUICK_S)
    return path.with_suffix(PLACEMENTS).read_bytes()


@pytest.fixture
def measured(path: Path, placements: bytes) -> Path:
    """Return a configuration for which four distances were measured."""
    path.with_suffix(PLACEMENTS).write_bytes(placements)
    return path


def session_of(path: Path, **how: bool) -> SiteSession:
    return SiteSession(load_configuration(path), **how)


def test_distances_are_proposed_from_near_to_the_farthest_that_a_rule_uses(path: Path) -> None:
    proposed_m = session_of(path).propose_m()
    assert len(proposed_m) == 5
    assert proposed_m == sorted(proposed_m)
    assert (proposed_m[0], proposed_m[-1]) == (0.5, 4.0)


@pytest.mark.long
def test_a_simulated_target_is_put_where_it_belongs_and_read_there(path: Path) -> None:
    placed = session_of(path).take(2.0, for_s=QUICK_S)
    assert placed.is_read
    assert placed.read_m == pytest.approx(placed.true_m, rel=0.01)


@pytest.mark.long
def test_a_certificate_and_its_page_are_written_and_checked(measured: Path) -> None:
    made = session_of(measured).finish()
    assert made.fit is not None
    assert made.reach is not None
    assert abs(made.fit.scale) < 0.01
    assert made.reach.reliable_m == pytest.approx(4.1)
    assert load_certificate(measured) == made
    names = sorted(each.name for each in measured.parent.iterdir())
    assert names == ["site.certificate.html", "site.certificate.json", "site.toml"]
    html = (measured.parent / "site.certificate.html").read_text()
    assert "Certificate of the site: site.toml" in html
    assert "near: below 1.00 m" in html
    assert "src=" not in html, "it needs no other file"
    assert [each for each in feasibility_warnings(load_configuration(measured)) if "certificate" in each.message] == []


@pytest.mark.long
def test_what_was_measured_is_kept_and_gone_on_with(measured: Path) -> None:
    again = session_of(measured)
    assert [each.tape_m for each in again.certificate.placements] == [*PLACES_M]
    assert set(again.propose_m()).isdisjoint(PLACES_M)
    again.finish()
    assert not measured.with_suffix(PLACEMENTS).exists()
    assert session_of(measured).certificate.placements == ()


@pytest.mark.parametrize("at_m", [-1.0, 0.0, 200.0, float("nan"), float("inf")])
def test_no_tape_measures_nonsense(path: Path, at_m: float) -> None:
    with pytest.raises(ConfigError, match="is no distance for a tape"):
        session_of(path).take(at_m)
    assert not path.with_suffix(PLACEMENTS).exists()


@pytest.mark.parametrize("sigma_m", [-0.001, 0.0, 0.3, float("nan")])
def test_a_distance_that_is_hardly_known_certifies_nothing(path: Path, sigma_m: float) -> None:
    with pytest.raises(ConfigError, match="certifies nothing"):
        session_of(path).take(1.0, sigma_m)


def test_a_target_that_is_not_seen_is_kept_as_not_seen_with_the_reason(path: Path) -> None:
    hidden = 'faults = [{ at = "0 s", for = "60 s", kind = "hide-target" }]\n'
    path.write_text(path.read_text() + hidden)
    placed = session_of(path).take(1.0, for_s=QUICK_S)
    assert (placed.found, placed.is_read) == (0, False)
    assert placed.reason
    assert session_of(path).certificate.placements == (placed,)


def test_the_demonstration_has_no_certificate() -> None:
    with pytest.raises(ConfigError, match="nothing is written beside the demonstration"):
        SiteSession(load_configuration(DEMONSTRATION))


# Certifying before a camera whose pictures come at their own pace: the view behind is saved.

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
TRUE_LENS = CameraModel.with_focal_length(600.0, 640, 480)
TAKEN_S = 1.0  # four pictures a tenth of a second apart make a view, on a busy machine too


def ball_at(near_side_m: float) -> Image:
    ball = BallTarget(position_m=(0.0, 0.0, near_side_m + 0.1), diameter_m=0.2)
    return render(Scene(camera=TRUE_LENS, target=ball, seed=1, backdrop=RoomBackdrop())).image


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """Return the configuration of a live camera, whose focal length is stated 4 % too long."""
    save_camera_model(tmp_path / "camera.toml", CameraModel.with_focal_length(624.0, 640, 480))
    (tmp_path / "site.toml").write_text(CONFIGURATION.format(device=tmp_path / "video0"))
    return tmp_path / "site.toml"


def take(site: Path, at_m: float, for_s: float = TAKEN_S) -> Placement:
    """Measure at a distance in a session of its own, as each request of the page has."""
    return SiteSession(load_configuration(site)).take(at_m, for_s=for_s)


def measure_at_three(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = V4l2Double.plugged_in(site.parent / "video0", ball_at(0.6), monkeypatch)
    for at_m in (0.6, 1.0, 2.0):
        camera.show(ball_at(at_m))
        take(site, at_m)


@pytest.mark.long
def test_a_live_camera_is_certified_on_the_page_and_its_view_is_saved(
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
    assert saved.lens == pytest.approx(lens_figures(load_camera_model(site.parent / "camera.toml")))
    assert made.fit is not None
    assert made.fit.has_wrong_scale
    assert "write into its file the focal length times 0.96" in " ".join(words)
