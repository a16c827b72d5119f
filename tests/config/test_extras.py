"""The line that installs what is missing works where it is shown; and so does the place of a guide."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from stadimeter.config import extras
from stadimeter.config.extras import LIBRARIES, NOT_IN_PACKAGE, install_line


@pytest.mark.parametrize("extra", sorted(LIBRARIES.keys() - NOT_IN_PACKAGE))
def test_the_package_has_no_pip_so_no_line_names_it(monkeypatch: pytest.MonkeyPatch, extra: str) -> None:
    assert f"{sys.executable} -m pip install 'stadimeter[{extra}]'" in install_line(extra)
    monkeypatch.setattr(sys, "prefix", "/opt/stadimeter/current")
    monkeypatch.setattr(sys, "executable", "/opt/stadimeter/current/bin/python3")
    line = install_line(extra)
    assert line.startswith("sudo apt install ")
    assert "/opt/stadimeter/current" not in line
    assert "pip" not in line


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
