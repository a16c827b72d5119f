"""Make the pictures of the documentation: `make pictures`."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

import camera_table
import fleet_picture
from gallery import make_gallery
from how_it_measures import make_steps
from live_view_svg import save_svg
from measuring_ball import ball_picture
from web_pages import make_pages

from stadimeter.app.bootstrap import build, demo_configuration
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.loop import Loop
from stadimeter.app.watching import live_feed
from stadimeter.cli.demo import fault_keys
from stadimeter.cli.keyboard import Keyboard, RunKeys
from stadimeter.cli.live_view import LiveView
from stadimeter.config.loader import load_configuration
from stadimeter.config.plugins import ACTUATORS, BUTTONS, DriverChoice, load_driver
from stadimeter.config.toml_source import parse_toml
from stadimeter.core.frame import Frame
from stadimeter.workbench.printing import write_drawings
from stadimeter.workbench.wiring import circuits_picture, find_outputs, parts_of, wiring_picture

HERE = Path(__file__).parent
ROOT = HERE.parents[1]

LIVE_VIEW_SECONDS = 24.6
"""The live view is taken after this long in the demonstration."""


class ShownKeyboard(Keyboard):
    """A keyboard that is there, so that the picture shows the keys."""

    is_there = True


def live_view_picture(path: Path, seconds: float, width: int = 96, height: int = 32) -> None:
    """Run the demonstration as fast as it goes, and take a picture of its live view.

    Args:
        path: The SVG file to write.
        seconds: After how long in the simulated world the picture is taken.
        width: Columns of the terminal in the picture.
        height: Its rows.
    """
    loop = Loop(build(demo_configuration(), speed=None))
    keys = RunKeys(loop, fault_keys(loop), can_pause=True, keyboard=ShownKeyboard())
    view = LiveView("stadimeter demo", live_feed(loop), keys=keys)

    def watch(record: CycleRecord, _frame: Frame | None) -> None:
        view.update(record)
        if record.observation.now_s >= seconds:
            save_svg(view, path, width, height, title="make demo")  # while the run still goes on
            loop.stop("the picture is taken")

    loop.listeners.append(watch)
    loop.run()


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
    live_view_picture(HERE / "live-view.svg", LIVE_VIEW_SECONDS)
    fleet_picture.draw(HERE / "fleet-view.svg")
    wiring_pictures(HERE)
    printed_page(HERE / "print-tag.svg")
    make_gallery(HERE)
    make_steps(HERE)
    ball_picture(HERE / "measuring-ball.jpg")
    make_pages(HERE)
    camera_table.write()
