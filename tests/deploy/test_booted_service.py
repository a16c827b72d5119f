"""The unit as it is, under a real systemd: ready, watched, killed when it hangs, switched off, reloaded, stopped.

It needs root, namespaces, debootstrap and a network. ``BOOTED_ROOT`` is the folder of a root with systemd and dbus that
was made before; it is written to.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import stadimeter
from stadimeter.testing.rig import eventually
from support.debian_root import Booted, booted, root_to_boot, why_no_root
from support.simulated_run import SIMULATED_BALL

pytestmark = [
    pytest.mark.long,
    pytest.mark.timeout(900),
    pytest.mark.skipif(bool(why_no_root()), reason=why_no_root() or "it can"),
]

CONFIGURATION = (
    SIMULATED_BALL
    + """
[actuators.buzzer]
driver = "vibration-motor"
pin = 18
[actuators.fan]
driver = "relay"
pin = 5
[rules.near]
actuator = "buzzer"
when = { below = "3 m" }
[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
"""
)

LIBRARIES = Path(pytest.__file__).parents[1]
SOURCE = Path(stadimeter.__file__).parents[1]

PROGRAM = f"""#!/bin/sh
export PYTHONHOME={sys.base_prefix} PYTHONPATH={SOURCE}:{LIBRARIES} PYTHONDONTWRITEBYTECODE=1
export LD_LIBRARY_PATH={sys.base_prefix}/lib
exec {sys.base_prefix}/bin/python{sys.version_info.major}.{sys.version_info.minor} -m stadimeter "$@"
"""

OFF = ["set 18 op dl", "set 5 op dh"]


def safe_outputs(deploy: Path) -> str:
    """Return the script with this Python and this checkout in the place of the package's."""
    text = (deploy / "safe-outputs").read_text().replace('"$here"/../src/', f"{SOURCE}/")
    python = f"{sys.base_prefix}/bin/python{sys.version_info.major}.{sys.version_info.minor}"
    libraries = f"export LD_LIBRARY_PATH={sys.base_prefix}/lib"
    return text.replace("python=$here/../bin/python3\n", f"{libraries}\npython={python}\n")


def put(root: Path, place: str, text: str, mode: int = 0o644) -> None:
    path = root / place
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(mode)


@pytest.fixture(scope="module")
def computer(deploy: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Booted]:
    root = root_to_boot(tmp_path_factory.mktemp("booted"))
    home = str(Path(sys.base_prefix))
    if any(place.is_relative_to("/tmp") for place in (SOURCE, LIBRARIES)):  # noqa: S108
        pytest.skip("the service has a /tmp of its own, in which this checkout is not")
    if home == "/usr":  # bound into the root, it would hide the root's own programs
        pytest.skip("this Python is the system's own")
    unit = (deploy / "stadimeter.service").read_text()
    if home.startswith(("/root", "/home")):  # a Python that somebody built at home
        unit = unit.replace("ProtectHome=yes", "ProtectHome=no")
    put(root, "usr/lib/systemd/system/stadimeter.service", unit)
    put(root, "etc/systemd/system/stadimeter.service.d/pins.conf", "[Service]\nEnvironment=GPIOZERO_PIN_FACTORY=mock\n")
    put(root, "usr/lib/stadimeter/safe-outputs", safe_outputs(deploy), 0o755)
    put(root, "usr/bin/pinctrl", '#!/bin/sh\necho "$*" >>/root/pins\n', 0o755)
    put(root, "opt/stadimeter/bin/stadimeter", PROGRAM, 0o755)
    put(root, "etc/stadimeter/appliance.toml", CONFIGURATION)
    (root / "root").chmod(0o755)
    (groups,) = re.findall(r"^SupplementaryGroups=(.*)$", unit, re.MULTILINE)
    for group in groups.split():  # as the package makes them, where the system has not
        subprocess.run(["chroot", root, "groupadd", "--system", "--force", group], check=False, capture_output=True)
    user = ["useradd", "--system", "--user-group", "stadimeter"]
    subprocess.run(["chroot", root, *user], check=False, capture_output=True)
    try:
        with booted(root, tuple(dict.fromkeys((Path(home), SOURCE, LIBRARIES)))) as computer:
            if "run" not in (said := computer.run("/opt/stadimeter/bin/stadimeter --help 2>&1")):
                pytest.skip(f"this Python does not run in there: {said[-300:]}")
            yield computer
    except RuntimeError as error:
        pytest.skip(f"no systemd can be booted here: {error}")


@pytest.fixture
def running(computer: Booted) -> Iterator[Booted]:
    (computer.root / "root/pins").write_text("")
    started = computer.run("systemctl start stadimeter 2>&1 || journalctl -u stadimeter --no-pager | tail -20")
    assert started == "", started
    yield computer
    computer.run("systemctl stop stadimeter")


def told(computer: Booted, name: str) -> str:
    return computer.run(f"systemctl show stadimeter --property={name} --value").strip()


def pins(computer: Booted) -> list[str]:
    return (computer.root / "root/pins").read_text().splitlines()


def test_it_is_ready_and_says_how_it_is(running):
    assert told(running, "ActiveState") == "active"
    assert told(running, "OOMScoreAdjust") == "-500"
    assert eventually(lambda: told(running, "StatusText").startswith("ball 2.0"))


@pytest.mark.parametrize("signal", ["STOP", "KILL"])
def test_a_process_that_hangs_or_is_killed_is_switched_off_and_started_again(running, signal):
    process = told(running, "MainPID")
    running.run(f"kill -{signal} {process}")
    assert eventually(lambda: pins(running) == OFF)
    assert eventually(lambda: told(running, "ActiveState") == "active" and told(running, "MainPID") != process)


def test_a_reload_keeps_the_process_and_a_wrong_file_is_refused(running):
    process = told(running, "MainPID")
    file = running.root / "etc/stadimeter/appliance.toml"
    for text, is_taken in ((CONFIGURATION.replace("3 m", "4 m"), True), ("nonsense", False), (CONFIGURATION, True)):
        file.write_text(text)
        assert (running.run("systemctl reload stadimeter; echo $?").splitlines()[-1] == "0") is is_taken
        assert (told(running, "ActiveState"), told(running, "MainPID")) == ("active", process)


def test_a_stop_switches_off_and_leaves_the_event_log_and_nothing_in_run(running):
    running.run("systemctl stop stadimeter")
    assert told(running, "Result") == "success"
    assert pins(running) == OFF
    assert running.run("ls /run/stadimeter 2>/dev/null") == ""
    assert "ended: SIGTERM" in running.run("/opt/stadimeter/bin/stadimeter events --lines 1")


def test_one_that_is_masked_while_it_runs_is_ended_as_the_doctor_says_whose_remedy_starts_it_again(running):
    running.run("systemctl mask stadimeter")
    assert eventually(lambda: told(running, "ActiveState") == "failed")
    found = json.loads(running.run("/opt/stadimeter/bin/stadimeter doctor --json 2>/dev/null"))
    (said,) = (each for each in found["checks"] if "is masked" in each["seen"])
    assert said["seen"].startswith("the service is masked and has failed (watchdog): nothing starts it")
    for command in re.findall("`sudo (.*?)`", said["remedy"]):
        running.run(command)
    assert told(running, "ActiveState") == "active"
