"""Root sees what the user of the service would: its files, by its groups."""

from __future__ import annotations

import os
import stat
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from typer.testing import CliRunner

from stadimeter.app import this_computer
from stadimeter.app.persistence.alarm_store import AlarmStore, describe_kept
from stadimeter.app.persistence.resumption import ClockReading, Memory
from stadimeter.cli.check import SERVICE_USER
from stadimeter.cli.main import app
from stadimeter.config.loader import load_configuration
from stadimeter.core.alarms.machine import AlarmRecord
from stadimeter.core.alarms.state import SetThreshold
from stadimeter.core.persistence import AlarmSnapshot
from support.simulated_run import SIMULATED_BALL


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


def in_child(act: Callable[[], str]) -> str:
    """Return what a function returns in a process of its own, which may become another user for good."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:  # pragma: no cover - in another process
        try:
            os.write(writing, act().encode())
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading, encoding="utf-8") as told:
        answer = told.read()
    os.waitpid(child, 0)
    return answer


@pytest.fixture
def readable() -> Iterator[Path]:
    """Yield a folder that every user may look into; pytest's own are for one user."""
    if os.geteuid() != 0:
        pytest.skip("only root becomes another user")
    with TemporaryDirectory(prefix="stadimeter-") as folder:
        Path(folder).chmod(0o755)
        yield Path(folder)


def test_whoever_root_becomes_may_no_longer_read_what_is_roots(readable):
    secret = readable / "secret"
    secret.write_text("x")
    secret.chmod(0o600)

    def act() -> str:
        this_computer.become("nobody", ("no-such-group",))
        return f"{os.access(secret, os.R_OK)} {os.getresuid()} {os.environ['HOME']} {os.environ['USER']}"

    assert in_child(act) == "False (65534, 65534, 65534) /nonexistent nobody"


@pytest.fixture
def as_root(readable: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of the service's configurations, for root as it is: in a home that nobody else looks into."""
    home, etc, state = (readable / name for name in ("root", "etc", "state"))
    for folder, mode in ((home, 0o700), (etc, 0o770), (state, 0o755)):
        folder.mkdir()
        folder.chmod(mode)
        os.chown(folder, *((0, 0) if folder == home else (65534, 65534)))
    monkeypatch.chdir(home)
    for name in ("HOME", "XDG_STATE_HOME", "XDG_CONFIG_HOME", "XDG_CACHE_HOME"):
        monkeypatch.setenv(name, str(home))
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setattr(sys, "prefix", "/opt/stadimeter/1.0")
    monkeypatch.setattr(this_computer, "SERVICE_USER", "nobody")
    monkeypatch.setattr(this_computer, "SERVICE_STATE", state)
    monkeypatch.setattr(this_computer, "CONFIGURATIONS", etc)
    return etc


RULES = """
[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]

[rules.near]
actuator = "motor"
when = { below = "50 cm" }
"""


@pytest.mark.parametrize("is_relative", [False, True])
def test_root_checks_the_configuration_of_the_service_with_the_thresholds_that_the_service_keeps(as_root, is_relative):
    file, elsewhere = as_root / "appliance.toml", as_root.parent / "appliance.toml"
    for each in (file, elsewhere):
        each.write_text(SIMULATED_BALL + RULES)
    file.chmod(0o640)
    os.chown(file, 0, 65534)
    state = this_computer.SERVICE_STATE / "appliance.sqlite3"
    store = AlarmStore(state)
    store.open()
    is_set = SetThreshold(key="below", value=0.6, configured=0.5, unit="m", at_s=1.0, by="zoe")
    store.write(
        Memory(
            moment=ClockReading(clock="boot one", at_s=1.0, unix_s=1.7e9, is_synchronised=True),
            alarms=(AlarmSnapshot(rule="near", meaning="a" * 64, record=AlarmRecord(thresholds=(is_set,))),),
        )
    )
    store.close()
    os.chown(state, 65534, 65534)
    state.chmod(stat.S_IRUSR | stat.S_IWUSR)

    # The Python of the tests may be for root alone: what is loaded late is loaded by one who may.
    assert CliRunner().invoke(app, ["check", str(elsewhere)]).exit_code == 0
    assert tuple(describe_kept(state, load_configuration(elsewhere).plan.rules))

    def check() -> str:
        result = CliRunner().invoke(app, ["check", "../etc/appliance.toml" if is_relative else str(file)])
        return f"{result.exit_code} {result.exception!r}\n{result.output}"

    told = in_child(check)
    assert told.startswith("0 "), told
    assert f"can be used by the user {SERVICE_USER}" in told
    assert "`near`: below is set to 0.60 m (2.0 ft) by zoe; the configuration says 0.50 m (1.6 ft)." in told


def test_the_environment_names_no_folder_of_roots_once_root_is_the_service(as_root):
    def act() -> str:
        this_computer.become_service_user(as_root / "appliance.toml")
        return "\n".join(f"{key}={value}" for key, value in os.environ.items() if str(as_root.parent / "root") in value)

    assert in_child(act) in {"", f"PWD={as_root.parent / 'root'}"}


def test_whoever_is_not_root_or_has_no_packaged_service_stays_who_they_are(monkeypatch):
    before = os.getresuid()
    installed = Path("/etc/stadimeter/appliance.toml")
    assert not this_computer.become_service_user(installed)
    monkeypatch.setattr(sys, "prefix", "/opt/stadimeter/1.0")
    assert not this_computer.become_service_user(Path("mine.toml"))
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert not this_computer.become_service_user(installed)
    assert os.getresuid() == before
