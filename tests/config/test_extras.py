"""The line that installs what is missing works where it is shown; and so does the place of a guide."""

from __future__ import annotations

import shlex
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from stadimeter.config import extras
from stadimeter.config.extras import LIBRARIES, NOT_IN_PACKAGE, install_line


@pytest.mark.parametrize("extra", sorted(LIBRARIES.keys() - NOT_IN_PACKAGE))
def test_the_package_has_no_pip_so_no_line_names_it(monkeypatch: pytest.MonkeyPatch, extra: str) -> None:
    monkeypatch.setattr(extras, "WITHOUT_LGPIO", (4, 0))
    assert f"{sys.executable} -m pip install 'stadimeter[{extra}]'" in install_line(extra)
    monkeypatch.setattr(sys, "prefix", "/opt/stadimeter/current")
    monkeypatch.setattr(sys, "executable", "/opt/stadimeter/current/bin/python3")
    line = install_line(extra)
    assert line.startswith("sudo apt install ")
    assert "/opt/stadimeter/current" not in line
    assert "pip" not in line


def test_where_pip_has_no_wheel_of_lgpio_the_systems_is_made_visible_in_place(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(extras, "WITHOUT_LGPIO", sys.version_info[:2])
    venv.create(tmp_path / "env", symlinks=True)
    (tmp_path / "env/bin/own").touch()
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "env"))
    asked, _, making = install_line("pi").partition(" && ")
    assert asked == "sudo apt install python3-lgpio"
    subprocess.run([sys.executable, *shlex.split(making)[1:], "--without-pip"], check=True)
    assert "include-system-site-packages = true" in (tmp_path / "env/pyvenv.cfg").read_text()
    assert (tmp_path / "env/bin/own").exists()
    monkeypatch.setattr(sys, "path", [*sys.path, str(extras.SYSTEM_PACKAGES)])
    assert install_line("pi") == asked


@pytest.mark.parametrize("extra", sorted(NOT_IN_PACKAGE))
def test_what_the_package_does_not_bring_goes_where_the_package_finds_it(
    monkeypatch: pytest.MonkeyPatch, extra: str
) -> None:
    monkeypatch.setattr(sys, "prefix", "/opt/stadimeter/current")
    assert install_line(extra).endswith(f" pip install --target /opt/stadimeter/drivers {LIBRARIES[extra]}")


def test_a_guide_is_named_in_the_checkout_in_the_package_or_on_the_web(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert extras.guide("troubleshooting.md") == "docs/troubleshooting.md"
    monkeypatch.setattr(extras, "GUIDES_OF_CHECKOUT", tmp_path / "none")
    monkeypatch.setattr(extras, "GUIDES_OF_PACKAGE", tmp_path)
    (tmp_path / "troubleshooting.md").touch()
    assert extras.guide("troubleshooting.md") == f"{tmp_path}/troubleshooting.md"
    (tmp_path / "troubleshooting.md").unlink()  # by path-exclude
    assert extras.guide("troubleshooting.md").startswith("https://github.com/")
