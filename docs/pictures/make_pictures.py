"""Make the pictures of the documentation: `make pictures`."""

from __future__ import annotations

from pathlib import Path

from live_view_svg import save_svg

from stadimeter.app.bootstrap import build, demo_configuration
from stadimeter.app.cycle_record import CycleRecord
from stadimeter.app.loop import Loop
from stadimeter.cli.demonstration import fault_keys
from stadimeter.cli.keyboard import Keyboard, RunKeys
from stadimeter.cli.viewing import live_view_of
from stadimeter.core.frame import Frame

HERE = Path(__file__).parent

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


if __name__ == "__main__":
    live_view_picture(HERE / "live-view.svg", LIVE_VIEW_SECONDS)
