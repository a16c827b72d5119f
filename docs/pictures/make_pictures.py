"""Make the pictures of the documentation: `make pictures`."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import camera_table
import cv2
from gallery import make_gallery
from live_view_svg import save_svg

from stadimeter.app.bootstrap import build, demo_configuration
from stadimeter.app.cycle_record import CycleRecord
from stadimeter.app.loop import Loop
from stadimeter.cli.demonstration import fault_keys
from stadimeter.cli.keyboard import Keyboard, RunKeys
from stadimeter.cli.viewing import live_view_of
from stadimeter.config.camera_file import save_camera_model
from stadimeter.config.loader import load_configuration
from stadimeter.config.plugins import ACTUATORS, DriverChoice, load_plugin
from stadimeter.config.toml_source import parse_toml
from stadimeter.core.frame import Frame
from stadimeter.workbench.drawing.files import write_drawings
from stadimeter.workbench.wiring.picture import circuit_picture, wiring_picture
from support.scenes.draw import sheet_scene
from support.scenes.floor import FloorBackdrop, Ground
from support.scenes.render import render

HERE = Path(__file__).parent
ROOT = HERE.parents[1]

LIVE_VIEW_SECONDS = 24.6
"""The live view is taken after this long in the demonstration."""


class ShownKeyboard(Keyboard):
    """A keyboard that is there, so that the picture shows the keys."""

    is_there = True


def live_view_picture(path: Path, seconds: float, width: int = 120, height: int = 35) -> None:
    """Run the demonstration as fast as it goes, and take a picture of its live view.

    Args:
        path: The SVG file to write.
        seconds: After how long in the simulated world the picture is taken.
        width: Columns of the terminal in the picture.
        height: Its rows.
    """
    loop = Loop(build(demo_configuration(), speed=None))
    keys = RunKeys(loop, fault_keys(loop), can_pause=True, keyboard=ShownKeyboard())
    view = live_view_of(loop, "stadimeter demo", "m", keys)

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
}


def wiring_pictures(folder: Path) -> None:
    """Draw the wiring of an example, and each circuit by itself.

    Args:
        folder: Where to.
    """
    actuators = load_configuration(ROOT / "config" / "distance-alert.toml").actuators
    write_drawings(folder / "wiring-distance-alert.svg", [wiring_picture(actuators)])
    for name, table in CIRCUITS.items():
        options = parse_toml(table, "").table
        plugin = load_plugin(ACTUATORS, options.pop("driver"))
        choice = DriverChoice(name=name, driver=name, plugin=plugin, options=plugin.options.model_validate(options))
        write_drawings(folder / f"wiring-{name}.svg", [circuit_picture(choice)])


def printed_page(path: Path) -> None:
    """Make a page with a tag, as `stadimeter print` does.

    Args:
        path: The SVG file to write.
    """
    command = [sys.executable, "-m", "stadimeter", "print", "tag", "8cm", "--family", "36h11", "-o", str(path)]
    subprocess.run(command, check=True)  # noqa: S603


def measured_sheet_picture(path: Path) -> None:
    """Render a sheet of A4 above a wooden floor, and have it measured and annotated by the command that people use."""
    floor = FloorBackdrop(ground=Ground.WOOD, bgr=(80, 120, 160))
    scene = replace(sheet_scene(seed=6, tilt_rad=0.5), backdrop=floor)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cv2.imwrite(str(folder / "sheet.png"), render(scene).image)
        save_camera_model(folder / "camera.toml", scene.camera)
        measure = "stadimeter measure sheet.png --camera camera.toml --sheet A4 --annotate ."
        subprocess.run([sys.executable, "-m", *measure.split()], check=True, cwd=folder)  # noqa: S603
        cv2.imwrite(str(path), cv2.imread(str(folder / "sheet-measured.png")), [cv2.IMWRITE_JPEG_QUALITY, 90])


if __name__ == "__main__":
    live_view_picture(HERE / "live-view.svg", LIVE_VIEW_SECONDS)
    wiring_pictures(HERE)
    printed_page(HERE / "print-tag.svg")
    make_gallery(HERE)
    camera_table.write()
    measured_sheet_picture(HERE / "sheet.jpg")
