"""Cameras as people name them in one line: a device, an address, or a driver with options."""

from __future__ import annotations

from typing import Any

import pytest

from stadimeter.config.toml_source import camera_table


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
