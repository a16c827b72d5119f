"""Writes what commands of the guides need: a picture, its camera file, and a simulated run.

``python docs/pictures/example_pictures.py FOLDER``, with ``tests`` in the path.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
from how_it_measures import CAMERA, sheet_in_a_room
from msgspec.structs import replace

from stadimeter.config.camera_file import save_camera_model

NEAR = """\
[camera]
driver = "simulated"
model = { width_px = 640, height_px = 480, fx_px = 600.0 }
[targets.ball]
detector = "ball"
diameter = "20 cm"
hsv = "29,86,6:64,255,255"
[actuators.buzzer]
driver = "simulated"
[rules.near]
actuator = "buzzer"
when = { below = "2 m" }
[world]
ball_diameter = "20 cm"
loop = false
path = [{ at = "0 s", x = "4 m", y = "0 m" }, { at = "10 s", x = "1 m", y = "0 m" }]
"""

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    save_camera_model(folder / "camera.toml", replace(CAMERA, focal_relative_sigma=0.007))
    cv2.imwrite(str(folder / "door.png"), sheet_in_a_room(things=4))
    (folder / "near.toml").write_text(NEAR)
