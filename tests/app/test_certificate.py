"""By the certificate beside a configuration, `check` says which thresholds the site does not carry."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.app.certificate import Certificate, Site, load_certificate, save_certificate
from stadimeter.app.feasibility import feasibility_warnings
from stadimeter.app.places import CERTIFICATE
from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.errors import Problem
from stadimeter.ranging.site_fit import Placement, find_reach, fit_site
from support.simulated_run import LENS

BALL = f"""
[camera]
driver = "simulated"
{LENS}
[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "29,86,6:64,255,255"

[actuators.motor]
driver = "simulated"
"""
WORLD = """
[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
"""
NEAR = '[rules.near]\nactuator = "motor"\nwhen = { below = "1 m", deadband = "10 cm" }\n'
PLACES_M = (0.5, 1.0, 2.0, 3.0)


def loaded(folder: Path, rules: str = NEAR, text: str = BALL) -> Configuration:
    (folder / "site.toml").write_text(text + rules + WORLD)
    return load_configuration(folder / "site.toml")


def certified(configuration: Configuration, noise_m: float = 0.002, scale: float = 0.0) -> Certificate:
    """Return a certificate of placements from 0.5 to 3 m, and save it."""
    placements = [
        Placement(
            tape_m=at_m, true_m=at_m, tape_sigma_m=0.002, frames=50, found=50, size_px=100 / at_m,
            read_m=(1 + scale) * at_m, read_sigma_m=0.001, spread_m=noise_m * at_m**2, noise_m=noise_m * at_m**2,
        )
        for at_m in PLACES_M
    ]  # fmt: skip
    fit = fit_site(placements)
    made = Certificate(
        target="ball",
        about=Site(configuration).about,
        date="2026-01-01 12:00",
        placements=tuple(placements),
        fit=fit,
        reach=find_reach(placements, fit),
    )
    save_certificate(configuration.path, made, CERTIFICATE)
    return made


def warnings(configuration: Configuration) -> tuple[Problem, ...]:
    return tuple(each for each in feasibility_warnings(configuration) if "certificate" in each.message)


def test_a_threshold_within_what_was_measured_is_carried(tmp_path):
    configuration = loaded(tmp_path)
    made = certified(configuration)
    assert warnings(configuration) == ()
    assert load_certificate(configuration.path) == made


@pytest.mark.parametrize(
    "rule",
    [
        'when = { above = "6 m" }',
        'when = { any = [{ below = "1 m" }, { below = "6 m" }] }',
        'when = { below = "1 m" }\nsuppress_when = { above = "6 m" }',
        'ramp = { from = "1 m", to = "6 m" }',
    ],
)
def test_a_threshold_beyond_the_farthest_placement_is_not_carried(tmp_path, rule):
    configuration = loaded(tmp_path, f'[rules.far]\nactuator = "motor"\n{rule}\n')
    certified(configuration)
    (far,) = warnings(configuration)
    assert far.code == "not-carried"
    assert "6.00 m: by the certificate of 2026-01-01 12:00, distances were found reliable to 3.00 m" in far.message
    assert far.message.endswith(", where nothing was measured beyond")
    assert far.key.startswith("rules.far")
    assert far.line > 0


def test_another_lens_makes_it_out_of_date_and_another_rule_does_not(tmp_path):
    certified(loaded(tmp_path))
    assert warnings(loaded(tmp_path, NEAR.replace("1 m", "2 m"))) == ()
    (outdated,) = warnings(loaded(tmp_path, text=BALL.replace("fx_px = 600.0", "fx_px = 610.0")))
    assert outdated.code == "certificate-outdated"
    assert "out of date: the camera model changed since" in outdated.message


@pytest.mark.parametrize("text", [b"{", b"\xff", b"[]", b'{"target": 5}', b""])
def test_a_damaged_certificate_is_a_warning_and_no_crash(tmp_path, text):
    configuration = loaded(tmp_path)
    configuration.path.with_suffix(CERTIFICATE).write_bytes(text)
    (damaged,) = warnings(configuration)
    assert "cannot be read" in damaged.message


def test_what_one_reading_is_off_at_a_threshold_is_stated(tmp_path):
    configuration = loaded(tmp_path)
    (near,) = Site(configuration).reliances(certified(configuration, scale=-0.08, noise_m=0.02))
    assert near.bias_m == pytest.approx(-0.08, abs=0.001)
    assert 0.02 < near.sigma_m < 0.03
