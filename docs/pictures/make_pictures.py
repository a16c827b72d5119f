"""Make the pictures of the documentation: `make pictures`."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

import camera_table
import fleet_picture
from how_it_measures import make_steps
from measuring_ball import ball_picture
from moving_picture import make_moving_picture
from web_pages import make_pages

from stadimeter.config.loader import load_configuration
from stadimeter.config.plugins import ACTUATORS, BUTTONS, DriverChoice, load_driver
from stadimeter.config.toml_source import parse_toml
from stadimeter.workbench.printing import write_drawings
from stadimeter.workbench.wiring import circuits_picture, find_outputs, parts_of, wiring_picture

HERE = Path(__file__).parent
ROOT = HERE.parents[1]

CIRCUITS: dict[str, str] = {
    "motor": 'driver = "vibration-motor"\npin = 18',
    "led": 'driver = "led"\npin = 24',
    "relay": 'driver = "relay"\npin = 5',
    "button": 'driver = "gpio"\npin = 27',
}


def first_beep() -> tuple[DriverChoice, ...]:
    """Return what hangs on pins in the configuration that docs/raspberry-pi.md shows."""
    page = (ROOT / "docs" / "raspberry-pi.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"^```toml\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    with tempfile.NamedTemporaryFile("w", suffix=".toml") as file:
        file.write(_AROUND + shown)
        file.flush()
        return parts_of(load_configuration(Path(file.name)))


_AROUND = """
[camera]
driver = "simulated"
model = { width_px = 640, height_px = 480, fx_px = 600.0, fy_px = 600.0, cx_px = 319.5, cy_px = 239.5 }

[targets.ball]
detector = "ideal"

[world]
"""


def wiring_pictures(folder: Path) -> None:
    """Draw the wiring of an example, and each circuit by itself.

    Args:
        folder: Where to.
    """
    actuators = load_configuration(ROOT / "config" / "distance-alert.toml").actuators
    write_drawings(folder / "wiring-distance-alert.svg", [wiring_picture(actuators)])
    write_drawings(folder / "wiring-first-beep.svg", [wiring_picture(first_beep())])
    for name, table in CIRCUITS.items():
        options = parse_toml(table, "").table
        model = load_driver(BUTTONS if name == "button" else ACTUATORS, options.pop("driver"))
        choice = DriverChoice(name=name, driver=name, options=model.model_validate(options))
        write_drawings(folder / f"wiring-{name}.svg", [circuits_picture(find_outputs([choice]))])


def printed_page(path: Path) -> None:
    """Make a page with a tag, as `stadimeter print` does.

    Args:
        path: The SVG file to write.
    """
    command = [sys.executable, "-m", "stadimeter", "print", "tag", "8cm", "--family", "36h11", "-o", str(path)]
    subprocess.run(command, check=True)  # noqa: S603


if __name__ == "__main__":
    make_moving_picture(HERE / "demo.webp")
    fleet_picture.draw(HERE / "fleet-view.svg")
    wiring_pictures(HERE)
    printed_page(HERE / "print-tag.svg")
    make_steps(HERE)
    ball_picture(HERE / "measuring-ball.jpg")
    make_pages(HERE)
    camera_table.write()
