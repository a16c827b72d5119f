"""A threshold is written back to where it stands, in each form that a condition has."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.config.loader import load_configuration
from stadimeter.workbench.rule_settings import settings_of, with_settings

AROUND = """\
[camera]
driver = "simulated"
height = "1 m"
model = { width_px = 640, height_px = 480, fx_px = 600.0 }
[world]
[base]
driver = "simulated"
[targets.ball]
detector = "ideal"
[rules.it]
"""
FORMS = [
    ('below = "1 m"', "below", "2 m"),
    ('lost = "5 min"', "lost", "10 s"),
    ('seen = "5 s"', "seen", "6 s"),
    ('still = { for = "1 s" }', "still.for", "2 s"),
    ('base = { battery_below = "11 V" }', "base.battery_below", "10 V"),
    ('place = { axis = "height", above = "1 m" }', "place.above", "2 m"),
    ('speed = { axis = "sideways", above = "1 m/s" }', "speed.above", "2 m/s"),
]


def test_a_threshold_is_written_where_it_stands_and_every_other_setting_can_be_too(
    tmp_path: Path, subtests: pytest.Subtests
) -> None:
    path = tmp_path / "it.toml"
    for when, key, value in FORMS:
        with subtests.test(when=when):
            path.write_text(f"{AROUND}when = {{ {when} }}\n")
            configuration = load_configuration(path)
            text = with_settings(configuration, path.read_text(), "it", {key: value})
            assert text.endswith(f"= {{ {when} }}\n".replace(when.split('"')[-2], value))
            path.write_text(text)
            known = settings_of(load_configuration(path), "it")
            for other, setting in known.items():
                if other not in ("on_delay", "off_delay"):
                    path.write_text(with_settings(configuration, text, "it", {other: setting.value}))
                    load_configuration(path)
