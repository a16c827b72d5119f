"""The command `wiring`."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from stadimeter.cli.main import app

CONFIGURATIONS = Path(__file__).parents[2] / "config"


def run(*arguments: str | Path, columns: int = 80) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["wiring", *map(str, arguments)], env={"COLUMNS": str(columns)})
    return done.exit_code, done.output


def test_it_draws_what_hangs_on_each_pin() -> None:
    code, shown = run(CONFIGURATIONS / "distance-alert.toml")
    assert code == 0
    assert "pin 12  GPIO 18 ──[220 ohm]" in shown
    assert "pin 16  GPIO 23 ──[220 ohm]" in shown


def test_a_narrow_terminal_gets_what_it_can_show() -> None:
    _, shown = run(CONFIGURATIONS / "distance-alert.toml", columns=40)
    assert max(map(len, shown.splitlines())) <= 40


@pytest.mark.parametrize(("name", "begins"), [("wiring.svg", b"<svg"), ("wiring.pdf", b"%PDF-1.4")])
def test_it_draws_into_a_file(tmp_path: Path, name: str, begins: bytes) -> None:
    code, shown = run(CONFIGURATIONS / "distance-alert.toml", "-o", tmp_path / name)
    assert (code, shown) == (0, f"wrote {tmp_path / name}\n")
    assert (tmp_path / name).read_bytes().startswith(begins)


def test_another_kind_of_file_is_refused(tmp_path: Path) -> None:
    code, shown = run(CONFIGURATIONS / "distance-alert.toml", "-o", tmp_path / "wiring.png")
    assert code == 2
    assert ".pdf or .svg" in shown


def test_where_nothing_is_on_a_pin_there_is_nothing_to_wire() -> None:
    code, shown = run(CONFIGURATIONS / "demo.toml")
    assert code == 2
    assert "nothing to wire" in shown


def test_pins_that_the_pi_itself_uses_are_warned_of(tmp_path: Path) -> None:
    text = (CONFIGURATIONS / "distance-alert.toml").read_text().replace("pin = 18", "pin = 14")
    path = tmp_path / "alert.toml"
    path.write_text(text)
    code, shown = run(path)
    assert code == 0
    assert (
        "actuators.motor.pin: GPIO 14 is also for the serial console, which drives it high while the Pi boots" in shown
    )
