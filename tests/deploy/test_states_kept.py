"""Upgrades, and a removal with an installation after it, keep what ran running and what did not run still.

With the maintainer scripts, the units and the self-test as they are, dpkg and a real systemd; the program is a stand-in
that reports to systemd and sleeps. It needs root, namespaces, debootstrap and a network. ``BOOTED_ROOT`` is the folder
of a root with systemd and dbus that was made before; it is written to.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from stadimeter.testing.rig import eventually
from support.debian_root import Booted, booted, root_to_boot, why_no_root

pytestmark = [
    pytest.mark.long,
    pytest.mark.timeout(900),
    pytest.mark.skipif(bool(why_no_root()), reason=why_no_root() or "it can"),
]

PROGRAM = """
import os, pathlib, signal, socket, sys

VERSION = "@VERSION@"

def main():
    if "--journal" in sys.argv:  # the self-test
        path = sys.argv[sys.argv.index("--journal") + 1]
        pathlib.Path(path).write_text('{"observation": {"measurements": [{"distance_m": 1.5}]}}')
        return
    if sys.argv[1] not in ("run", "web"):
        return
    if "crashes" in pathlib.Path("/etc/stadimeter/appliance.toml").read_text():
        sys.exit(2)
    if address := os.environ.get("NOTIFY_SOCKET"):
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify:
            notify.connect("\\0" + address[1:] if address[0] == "@" else address)
            notify.send(f"STATUS={VERSION}\\nREADY=1".encode())
            while signal.sigtimedwait({signal.SIGTERM}, 0.5) is None:
                notify.send(b"WATCHDOG=1")
    else:
        signal.sigwait({signal.SIGTERM})

if __name__ == "__main__":
    main()
"""
STAND_INS = (
    "numpy",
    "cv2",
    "simplejpeg",
    "msgspec",
    "pydantic",
    "serial",
    "gpiozero",
    "paho/mqtt/client",
    "mcap",
    "zstandard",
)

RUN, PAGE = "stadimeter.service", "stadimeter-web.service"
STATES = [("enabled", True), ("disabled", True), ("enabled", False), ("disabled", False), ("masked", False)]
State = tuple[str, bool]


@pytest.fixture(scope="module")
def package(deploy: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str], Path]]:
    sys.path.insert(0, str(deploy))
    import make_deb

    def make(version: str) -> Path:
        folder = tmp_path_factory.mktemp("package")
        for name in STAND_INS:
            module = folder / "libraries" / f"{name}.py"
            module.parent.mkdir(parents=True, exist_ok=True)
            module.touch()
        (folder / "libraries/stadimeter").mkdir()
        (folder / "libraries/stadimeter/__main__.py").write_text(PROGRAM.replace("@VERSION@", version))
        target = make_deb.Target(
            release=make_deb.RELEASES["bookworm"], architecture=make_deb.this_architecture(), program_version=version
        )
        return make_deb.pack(target, folder / "libraries", folder, compression="none")

    os.umask(0o022)
    yield make
    sys.path.remove(str(deploy))


@pytest.fixture(scope="module")
def computer(package: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Booted]:
    root = root_to_boot(tmp_path_factory.mktemp("booted"), "python3.11", "gpiod", "python3-zstandard", "liblapack3")
    for version in ("1.0", "1.1"):
        shutil.copy(package(version), root / f"root/{version}.deb")
    unpacked = tmp_path_factory.mktemp("changed")
    subprocess.run(["dpkg-deb", "--raw-extract", root / "root/1.1.deb", unpacked], check=True)
    with (unpacked / "etc/stadimeter/appliance.toml").open("a") as example:
        example.write("# a better example\n")
    rebuild = ["dpkg-deb", "--root-owner-group", "--build", unpacked, root / "root/with-another-example.deb"]
    subprocess.run(rebuild, check=True, capture_output=True)
    try:
        with booted(root, ()) as computer:
            yield computer
    except RuntimeError as error:
        pytest.skip(f"no systemd can be booted here: {error}")


@pytest.fixture
def installed(computer: Booted) -> Iterator[Booted]:
    install(computer, "1.0")
    yield computer
    computer.run(f"systemctl unmask {RUN} {PAGE}; dpkg --purge stadimeter; systemctl reset-failed", timeout_s=120)


def install(computer: Booted, version: str) -> None:
    said = computer.run(f"dpkg --force-confold --install /root/{version}.deb 2>&1 && echo done", timeout_s=120)
    assert said.rstrip().endswith("done"), said
    assert eventually(lambda: "No jobs" in computer.run("systemctl list-jobs"))


def put(computer: Booted, unit: str, state: State) -> None:
    how, is_up = state
    computer.run(f"systemctl {'disable' if how == 'disabled' else 'enable'} {unit}")
    computer.run(f"systemctl {'start' if is_up else 'stop'} {unit}")
    if how == "masked":
        computer.run(f"systemctl mask {unit}")
    assert found(computer, unit) == state


def found(computer: Booted, unit: str) -> State:
    how, now = computer.run(f"systemctl is-enabled {unit}; systemctl is-active {unit}").split()
    return how, now == "active"


def process(computer: Booted, unit: str) -> str:
    return computer.run(f"systemctl show {unit} --property=MainPID --value").strip()


@pytest.mark.parametrize(("of_run", "of_page"), list(zip(STATES, STATES[::-1], strict=True)))
def test_an_upgrade_keeps_the_state_of_both_services(installed, of_run, of_page):
    states = {RUN: of_run, PAGE: of_page}
    for unit, state in states.items():
        put(installed, unit, state)
    before = {unit: process(installed, unit) for unit in states}
    install(installed, "1.1")
    assert {unit: found(installed, unit) for unit in states} == states
    for unit, (_, is_up) in states.items():
        assert (process(installed, unit) != before[unit]) is is_up, "what ran runs in its new version"


@pytest.mark.parametrize(("of_run", "of_page"), list(zip(STATES, STATES[::-1], strict=True)))
def test_a_removal_and_an_installation_after_it_keep_the_state_of_both(installed, of_run, of_page):
    states = {RUN: of_run, PAGE: of_page}
    for unit, state in states.items():
        put(installed, unit, state)
    installed.run("dpkg --remove stadimeter", timeout_s=120)
    install(installed, "1.1")
    assert {unit: found(installed, unit) for unit in states} == states


def test_what_was_stopped_after_a_first_installation_is_not_started_by_the_second_upgrade(installed):
    put(installed, RUN, ("enabled", True))
    installed.run("dpkg --remove stadimeter", timeout_s=120)
    install(installed, "1.0")
    put(installed, RUN, ("enabled", False))
    install(installed, "1.1")
    assert found(installed, RUN) == ("enabled", False)


def test_one_that_crashes_and_waits_for_its_next_start_is_tried_with_the_new_version(installed):
    configuration = installed.root / "etc/stadimeter/appliance.toml"
    text = configuration.read_text()
    configuration.write_text(f"{text}\n# crashes\n")
    installed.run(f"systemctl start {RUN}")
    assert "activating" in installed.run(f"systemctl is-active {RUN}")
    install(installed, "1.1")
    configuration.write_text(text)
    assert eventually(lambda: found(installed, RUN) == ("disabled", True))


def test_a_first_installation_starts_and_enables_nothing(installed):
    assert {found(installed, unit) for unit in (RUN, PAGE)} == {("disabled", False)}


@pytest.mark.parametrize("is_edited", [True, False])
def test_an_edited_configuration_survives_an_upgrade_with_another_example(installed, is_edited):
    configuration = installed.root / "etc/stadimeter/appliance.toml"
    assert installed.run("stat --format='%a %U %G' /etc/stadimeter/appliance.toml") == "640 root stadimeter\n"
    text = configuration.read_text()
    if is_edited:
        configuration.write_text(f"{text}# mine\n")
    install(installed, "with-another-example")
    assert configuration.read_text() == text + ("# mine\n" if is_edited else "# a better example\n")
    assert installed.run("stat --format='%a %U %G' /etc/stadimeter/appliance.toml") == "640 root stadimeter\n"
