"""Certifying a site: distances one after the other, kept after each, and a certificate with its pages from all."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from stadimeter.app.certificate import Site, load_certificate
from stadimeter.app.certificate_stamp import PLACEMENTS
from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.config.camera_file import load_camera_model, save_camera_model
from stadimeter.config.loader import DEMONSTRATION, load_configuration
from stadimeter.core.camera_model import CameraModel
from stadimeter.errors import ConfigError
from stadimeter.workbench.certificate.session import SiteSession
from support.simulated_run import LENS

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


def too_long(path: Path, times: float) -> None:
    """Let what was measured be too long, as through a focal length that is."""
    file = path.with_suffix(PLACEMENTS)
    kept = json.loads(file.read_text())
    for each in kept["placements"]:
        each["read_m"] *= times
    kept["about"] = Site(load_configuration(path)).about
    file.write_text(json.dumps(kept))


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
    assert placed.rate_hz is None, "a stepped clock says nothing of a camera's pace"


@pytest.mark.long
def test_a_certificate_and_its_pages_are_written_and_checked(measured: Path) -> None:
    made = session_of(measured).finish()
    assert made.fit is not None
    assert made.reach is not None
    assert abs(made.fit.scale) < 0.01
    assert made.reach.reliable_m == pytest.approx(4.1)
    assert load_certificate(measured) == made
    names = sorted(each.name for each in measured.parent.iterdir())
    assert names == ["site.certificate.html", "site.certificate.json", "site.certificate.pdf", "site.toml"]
    assert (measured.parent / "site.certificate.pdf").read_bytes().startswith(b"%PDF-1.4")
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


def test_measuring_anew_forgets_what_was_measured(measured: Path) -> None:
    assert session_of(measured, anew=True).certificate.placements == ()


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


@pytest.fixture
def wrong_lens(measured: Path) -> Path:
    """Return a configuration with a camera file, whose placements were read 3 % too long."""
    save_camera_model(measured.parent / "camera.toml", CameraModel.with_focal_length(600.0, 640, 480))
    measured.write_text('[camera]\ndriver = "simulated"\nmodel = "camera.toml"\n' + ROOM)
    too_long(measured, 1.03)
    return measured


def test_a_correction_writes_the_camera_file_and_what_was_measured_fits_it(wrong_lens: Path) -> None:
    made = session_of(wrong_lens).finish(correct=True)
    assert made.fit is not None
    assert made.corrected == pytest.approx(1 / 1.03 - 1, abs=0.005)
    assert made.fit.scale == pytest.approx(0.0, abs=1e-9)
    model = load_camera_model(wrong_lens.parent / "camera.toml")
    assert model.fx_px == pytest.approx(600 / 1.03, rel=0.005)
    assert model.focal_relative_sigma == pytest.approx(made.fit.scale_sigma, rel=0.05)
    assert "by the certificate of site.toml" in model.provenance.notes[-1]
    assert [
        each for each in feasibility_warnings(load_configuration(wrong_lens)) if "certificate" in each.message
    ] == []


def test_nothing_is_corrected_unasked_and_a_finished_certificate_can_be_corrected_later(wrong_lens: Path) -> None:
    before = (wrong_lens.parent / "camera.toml").read_bytes()
    made = session_of(wrong_lens).finish()
    assert made.fit is not None
    assert made.fit.has_wrong_scale
    assert (wrong_lens.parent / "camera.toml").read_bytes() == before
    assert session_of(wrong_lens, again=True).finish(correct=True).corrected < -0.02


def test_a_lens_in_the_configuration_itself_is_not_corrected(measured: Path) -> None:
    too_long(measured, 1.05)
    with pytest.raises(ConfigError, match="only a camera file for air can be corrected"):
        session_of(measured).finish(correct=True)
