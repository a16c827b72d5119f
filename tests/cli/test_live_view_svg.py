"""The live view as a picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from live_view_svg import save_svg

from stadimeter.app.cycle import CycleRecord
from stadimeter.cli.run_panels import big_digits
from support.cycle_records import live_view

SVG = "{http://www.w3.org/2000/svg}"


def texts(path: Path) -> str:
    root = ET.parse(path).getroot()  # noqa: S314 - a file that we have just written
    assert root.tag == f"{SVG}svg"
    return "\n".join("".join(element.itertext()) for element in root.iter(f"{SVG}text")).replace("\xa0", " ")


@pytest.mark.parametrize(("width", "height"), [(80, 24), (120, 35)])
def test_the_picture_is_well_formed_and_holds_the_figures(
    make_record: Callable[..., CycleRecord], tmp_path: Path, width: int, height: int
) -> None:
    view, show = live_view("test <run> & more")
    for number in range(100):
        show(make_record(number / 10))
    save_svg(view.render(), tmp_path / "view.svg", width, height)
    shown = texts(tmp_path / "view.svg")
    assert "test <run> & more" in shown
    for words in ("± 0.04", "closing 0.21 m/s", "too-near", "active", "keep-off", "1.43 m too far", "62 %"):
        assert words in shown
    assert ("2.43 m" if width == 80 else big_digits("2.43")[1]) in shown


def test_the_same_view_gives_the_same_picture(make_record: Callable[..., CycleRecord], tmp_path: Path) -> None:
    view, show = live_view()
    show(make_record())
    for name in ("one.svg", "other.svg"):
        save_svg(view.render(), tmp_path / name)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "other.svg").read_bytes()
