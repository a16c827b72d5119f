"""A message names a guide where it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.config import guides


def test_a_guide_is_named_in_the_checkout_in_the_package_or_on_the_web(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert guides.guide("doctor.md") == "docs/doctor.md"
    monkeypatch.setattr(guides, "CHECKOUT", tmp_path / "none")
    monkeypatch.setattr(guides, "OF_PACKAGE", tmp_path)
    (tmp_path / "doctor.md").touch()
    assert guides.guide("doctor.md") == f"{tmp_path}/doctor.md"
    (tmp_path / "doctor.md").unlink()  # by path-exclude
    assert guides.guide("doctor.md").startswith("https://github.com/")
