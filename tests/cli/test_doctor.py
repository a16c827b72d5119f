"""`doctor` as people and programs see it."""

from __future__ import annotations

import json
import re
import socket
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from stadimeter.cli import doctor
from stadimeter.cli.main import app
from stadimeter.workbench.doctor.checks import Computer, DiagnosisSeverity
from support.broker import free_port
from support.captured_computers import PC, PI_4, ZERO_2, Captured

ROOT = Path(__file__).parents[2]


def run(captured: Captured, folder: Path, monkeypatch: pytest.MonkeyPatch, *arguments: object) -> Result:
    computer = captured.computer(folder / "root")
    monkeypatch.setattr(doctor, "Computer", lambda: computer)
    result = CliRunner().invoke(app, ["doctor", *map(str, arguments)])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_a_computer_that_is_set_up_exits_with_0(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = run(PI_4, tmp_path, monkeypatch)
    assert result.exit_code == 0
    assert result.stdout.splitlines()[:3] == [
        "This computer",
        " ✓  Raspberry Pi 4 Model B Rev 1.5, Debian GNU/Linux 12 (bookworm)",
        " ✓  no under-voltage and no throttling since the start (vcgencmd get_throttled: 0x0)",
    ]
    assert result.stdout.splitlines()[-1] == "1 not known; docs/troubleshooting.md says more"


def test_what_is_wrong_stands_above_its_remedy_and_exits_with_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = run(ZERO_2, tmp_path, monkeypatch)
    assert result.exit_code == 1
    lines = result.stdout.splitlines()
    at = lines.index(" ✗  under-voltage and throttled now (vcgencmd get_throttled: 0x50005)")
    assert lines[at + 1].startswith("    → use the supply for the board")


def test_a_configuration_that_is_not_there_is_a_mistake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = run(PC, tmp_path, monkeypatch, tmp_path / "none.toml")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "there is no configuration" in result.stderr


def test_its_help_explains_each_heading() -> None:
    helped = CliRunner().invoke(app, ["doctor", "computer", "--help"]).stdout
    assert {check.group for check in doctor.CHECKS if f"{check.group}: " not in helped} == set()


def with_broker(folder: Path, port: int, **keys: str) -> Path:
    config = folder / "box.toml"
    lines = (ROOT / "config" / "appliance.toml").read_text()
    more = "".join(f'{key} = "{value}"\n' for key, value in keys.items())
    config.write_text(re.sub(r'^host = "127.0.0.1".*\n', rf"\g<0>port = {port}\n{more}", lines, flags=re.MULTILINE))
    return config


def found(result: Result, check: str) -> list[dict[str, str]]:
    return [each for each in json.loads(result.stdout)["checks"] if each["check"] == check]


def test_a_report_names_no_secret_no_computer_and_no_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USER", "maker")
    config = with_broker(tmp_path, free_port(), username="gatekeeper", password_file="password.txt")
    config.write_text(config.read_text().replace("device = 0", 'device = "rtsp://me:pw@attic/1"', 1))
    result = run(ZERO_2, tmp_path, monkeypatch, config, "--json")
    for private in ("gatekeeper", "maker", "me:pw", "attic", str(tmp_path), socket.gethostname()):
        assert private not in result.stdout
    assert result.exit_code == 1
    assert "rtsp://me:pw@attic" in config.read_text()
    assert "…/password.txt cannot be read" in found(result, "broker")[0]["seen"]


@pytest.mark.long
def test_this_computer_is_examined_as_it_is() -> None:
    result = CliRunner().invoke(app, ["doctor", "--json"])
    record = json.loads(result.stdout)
    assert result.exit_code == (1 if record["wrong"] else 0)
    assert {each["severity"] for each in record["checks"]} <= set(DiagnosisSeverity)
    assert found(result, "libraries")[0]["severity"] == "fine"
    assert Computer().root == Path("/")
