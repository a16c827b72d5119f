"""The line that installs what is missing works where it is shown."""

from __future__ import annotations

import sys

import pytest

from stadimeter.config.extras import LIBRARIES, install_line


@pytest.mark.parametrize("extra", sorted(LIBRARIES))
def test_the_package_has_no_pip_so_no_line_names_it(monkeypatch: pytest.MonkeyPatch, extra: str) -> None:
    assert f"{sys.executable} -m pip install 'stadimeter[{extra}]'" in install_line(extra)
    monkeypatch.setattr(sys, "prefix", "/opt/stadimeter/current")
    monkeypatch.setattr(sys, "executable", "/opt/stadimeter/current/bin/python3")
    line = install_line(extra)
    assert line.startswith("sudo apt install ")
    assert "/opt/stadimeter/current" not in line
    assert "pip" not in line or "python3-pip && sudo python3 -m pip install --no-deps --target /opt/" in line
