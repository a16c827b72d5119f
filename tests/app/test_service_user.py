"""Root sees what the user of the service would: its files, by its groups."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from stadimeter.app import this_computer


def test_groups_are_those_of_the_unit_and_its_drop_ins(tmp_path, deploy):
    units = tmp_path / "usr/lib/systemd/system"
    units.mkdir(parents=True)
    (units / "stadimeter.service").write_text((deploy / "stadimeter.service").read_text())
    assert this_computer.groups_of_service(tmp_path) == ("gpio", "video", "dialout", "i2c")
    mine = tmp_path / "etc/systemd/system/stadimeter.service.d/mine.conf"
    mine.parent.mkdir(parents=True)
    mine.write_text("[Service]\nSupplementaryGroups=spi video\n")
    assert this_computer.groups_of_service(tmp_path) == ("gpio", "video", "dialout", "i2c", "spi")
    mine.write_text("[Service]\nSupplementaryGroups=\nSupplementaryGroups=i2c\n")
    assert this_computer.groups_of_service(tmp_path) == ("i2c",)
    mine.unlink()
    mine.parent.with_name("stadimeter.service").write_text("[Service]\nSupplementaryGroups=video\n")
    assert this_computer.groups_of_service(tmp_path) == ("video",)  # it replaces the package's whole unit
    assert this_computer.groups_of_service(tmp_path / "nowhere") == ()


@pytest.fixture
def deploy() -> Path:
    return Path(__file__).parents[2] / "deploy"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root becomes another user")
def test_whoever_root_becomes_may_no_longer_read_what_is_roots(tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("x")
    secret.chmod(0o600)
    for folder in (tmp_path, *tmp_path.parents[:2]):
        folder.chmod(0o755)
    child = os.fork()
    if child == 0:  # pragma: no cover - in another process
        this_computer.become("nobody", ("no-such-group",))
        os._exit(os.access(secret, os.R_OK) * 1 + (os.getresuid() != (65534,) * 3) * 2)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0


def test_whoever_is_not_root_or_has_no_packaged_service_stays_who_they_are(monkeypatch):
    before = os.getresuid()
    installed = Path("/etc/stadimeter/appliance.toml")
    assert not this_computer.become_service_user(installed)
    monkeypatch.setattr(sys, "prefix", "/opt/stadimeter/1.0")
    assert not this_computer.become_service_user(Path("mine.toml"))
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert not this_computer.become_service_user(installed)
    assert os.getresuid() == before
