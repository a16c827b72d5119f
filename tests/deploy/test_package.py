"""The Debian package in bare root file systems: installed, upgraded, broken on purpose, rolled back, removed, purged.

It needs root, debootstrap and a network. There is no systemd in a root, so what the package asks of it is written down
by a stand-in. ``DEBIAN_RELEASE=trixie`` and ``DEBIAN_ARCHITECTURE=arm64`` try other packages;
``DEBIAN_ROOT`` is the folder of such a root that was made before, which is left as it is.
"""

from __future__ import annotations

import filecmp
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from stadimeter.app.persistence.alarm_store import FORMAT
from stadimeter.testing.rig import eventually
from support.debian_root import DebianRoot, layered, make_root, why_no_root
from support.page import ServedPage

pytestmark = [
    pytest.mark.long,
    pytest.mark.timeout(900),
    pytest.mark.skipif(bool(why_no_root()), reason=why_no_root() or "it can"),
]

RELEASE = os.environ.get("DEBIAN_RELEASE", "bookworm")
ARCHITECTURE = os.environ.get("DEBIAN_ARCHITECTURE", "")

HOME = "/opt/stadimeter"
CONFIGURATION = "/etc/stadimeter/appliance.toml"
STATE = "/var/lib/stadimeter/appliance.sqlite3"
SIMULATED = Path(__file__).parents[2] / "deploy/debian/self-test.toml"

FAKE_SYSTEMCTL = """\
#!/bin/sh
echo "$* with $(cat /opt/stadimeter/current/version 2>/dev/null)" >>/root/systemctl.log
case "$*" in
    "is-active stadimeter.service") if [ -e /root/is-active ]; then echo active; else echo inactive; exit 3; fi ;;
    is-active*) echo inactive; exit 3 ;;
    is-enabled*) echo enabled ;;
esac
"""

NOTIFIER = """
[notifiers.phone]
driver = "apprise"
url = "ntfy://example.org/ball"
"""
NO_APPRISE = "the library apprise is not installed: run (.*)"

Package = Callable[..., Path]
Change = Callable[[Path], None]


@pytest.fixture(scope="module")
def make_deb(deploy: Path) -> Iterator[object]:
    sys.path.insert(0, str(deploy))
    import make_deb

    yield make_deb
    sys.path.remove(str(deploy))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("appliance")


@pytest.fixture(scope="module")
def package(make_deb, folder: Path) -> Package:
    """Return what makes a package of a version, with a change to its libraries if one is given."""
    release, architecture = make_deb.RELEASES[RELEASE], ARCHITECTURE or make_deb.this_architecture()
    os.umask(0o022)
    gathered = folder / "libraries"
    make_deb.gather(make_deb.Target(release=release, architecture=architecture, program_version="0"), gathered)

    def make(version: str, change: Change | None = None) -> Path:
        libraries = gathered
        if change is not None:
            libraries = folder / f"libraries-{version}"
            shutil.copytree(gathered, libraries, copy_function=os.link)
            change(libraries)
        target = make_deb.Target(release=release, architecture=architecture, program_version=version)
        return make_deb.pack(target, libraries, folder / "packages", compression="none")

    return make


def rewrite(place: str, old: str, new: str) -> Change:
    """Return a change of a file of the libraries. The others have links to the same file, so it is made anew."""

    def change(libraries: Path) -> None:
        (path,) = libraries.glob(place)
        text = path.read_text()
        assert old in text
        path.unlink()
        path.write_text(text.replace(old, new))

    return change


@pytest.fixture(scope="module")
def broken(package: Package) -> Path:
    return package("1.2", NUMPY_TRAP)


ASK_FOR_TROUBLE = """
from pathlib import Path
from stadimeter.app.control.client import ask
print(ask(Path("/run/stadimeter/appliance.sock"), "subscribe")["health"]["trouble"])
"""
NUMPY_TRAP = rewrite(
    "cv2/__init__.py", "import os", "raise ImportError('numpy.core.multiarray failed to import')\nimport os"
)
LATER_STATE = rewrite("stadimeter/app/persistence/alarm_store.py", f"FORMAT = {FORMAT}\n", f"FORMAT = {FORMAT + 1}\n")


@pytest.fixture(scope="module")
def bare(make_deb, folder: Path) -> DebianRoot:
    if made_before := os.environ.get("DEBIAN_ROOT"):
        return DebianRoot(Path(made_before))
    return make_root(folder / "bare", RELEASE, ARCHITECTURE or make_deb.this_architecture())


@pytest.fixture(scope="module")
def first(package: Package) -> Path:
    return package("1.0")


@pytest.fixture(scope="module")
def second(package: Package) -> Path:
    return package("1.1")


@pytest.fixture(scope="module")
def installed(bare: DebianRoot, first: Path, folder: Path) -> Iterator[Path]:
    """Return a root in which version 1.0 was installed by one command. Nothing may change it."""
    with ExitStack() as stack:
        try:
            root = stack.enter_context(layered(bare.path, folder / "installed"))
        except subprocess.CalledProcessError as error:
            pytest.skip(f"nothing can be mounted here: {error.stderr}")
        if (updated := root.try_to("apt-get", "update", "--error-on=any")).returncode:
            pytest.skip(f"no packages can be had here: {updated.stderr[-300:]}")
        done = root.install(first)
        assert done.returncode == 0, done.stderr
        assert "stadimeter check /etc/stadimeter/appliance.toml" in done.stdout
        root.run("apt-get", "clean")
        (root / "/root" / first.name).unlink()
        yield root.path


@pytest.fixture
def root(installed: Path, folder: Path, request: pytest.FixtureRequest) -> Iterator[DebianRoot]:
    with layered(installed, folder / request.node.name) as root:
        yield root


@pytest.fixture
def with_systemd(root: DebianRoot) -> Path:
    """Pretend that systemd runs; return the file in which its orders are."""
    (root / "/run/systemd/system").mkdir(parents=True)
    for name in ("systemctl", "udevadm"):
        program = root / f"/usr/bin/{name}"
        program.write_text(FAKE_SYSTEMCTL)
        program.chmod(0o755)
    (root / "/root/is-active").touch()
    return root / "/root/systemctl.log"


@pytest.fixture
def running(root: DebianRoot) -> Iterator[subprocess.Popen[str]]:
    """A run on a simulated camera in the root, begun with the version that is installed."""
    (root / CONFIGURATION).write_text(SIMULATED.read_text())
    (root / "/run/stadimeter").mkdir()
    command = root.command(
        "stadimeter", "run", CONFIGURATION, "--socket", "/run/stadimeter/appliance.sock", "--state", STATE
    )
    (root / STATE).parent.mkdir(exist_ok=True)
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        for line in process.stdout or ():
            if "near" in line:
                break
        assert process.poll() is None
        yield process
        process.send_signal(signal.SIGTERM)
        process.communicate()


def version(root: DebianRoot) -> str:
    return (root / HOME / "current/version").read_text().strip()


def left_in(root: DebianRoot) -> list[str]:
    return sorted(path.name for path in (root / HOME).iterdir())


def full(version: str) -> str:
    return f"{version}+{'deb12' if RELEASE == 'bookworm' else 'deb13'}"


def put(root: DebianRoot, package: Path) -> str:
    return shutil.copy(package, root / "/root").removeprefix(str(root.path))


@contextmanager
def small_disk(root: DebianRoot, place: str, size: str) -> Iterator[None]:
    """Put what is at a place on a disk of its own."""
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", root / "/mnt"], check=True)
    subprocess.run(["cp", "--archive", f"{root / place}/.", root / "/mnt"], check=True)
    subprocess.run(["mount", "--move", root / "/mnt", root / place], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", "--lazy", root / place], check=True)


def status(root: DebianRoot) -> str:
    return root.run("dpkg-query", "--show", "--showformat=${Status} ${Version}", "stadimeter")


def test_it_is_the_same_byte_for_byte_wherever_and_whenever_it_is_made(deploy: Path, tmp_path: Path) -> None:
    made = []
    for name, umask, zone, locale in (("here", 0o022, "UTC", "C"), ("elsewhere/again", 0o077, "Asia/Tokyo", "C.UTF-8")):
        checkout = tmp_path / name
        shutil.copytree(deploy.parent, checkout, ignore=shutil.ignore_patterns(".*", "__pycache__", "tests", "dist"))
        around = {"SOURCE_DATE_EPOCH": "1700000000", "TZ": zone, "LC_ALL": locale, "PYTHONPATH": f"{checkout}/src"}
        command = [sys.executable, checkout / "deploy/make_deb.py", "--release", RELEASE]
        subprocess.run(command, env=os.environ | around, umask=umask, cwd=checkout, check=True)
        made += checkout.glob("dist/*.deb")
    assert filecmp.cmp(*made, shallow=False)


class TestInstallation:
    def test_it_is_whole_and_small_enough(self, root):
        assert status(root) == f"install ok installed {full('1.0')}"
        assert root.run("stadimeter", "--version").startswith("stadimeter ")
        assert sum(path.lstat().st_size for path in (root / HOME).rglob("*")) < 200e6
        occupied_kb = int(root.run("du", "--summarize", HOME).split()[0])
        said_kb = int(root.run("dpkg-query", "--show", "--showformat=${Installed-Size}", "stadimeter"))
        assert 0.97 < said_kb / occupied_kb < 1.03

    def test_a_library_that_it_does_not_bring_is_installed_by_the_command_of_the_message(self, root):
        (root / CONFIGURATION).write_text(SIMULATED.read_text() + NOTIFIER)
        (command,) = re.findall(NO_APPRISE, root.try_to("stadimeter", "check", CONFIGURATION).stdout)
        shutil.copy("/etc/ssl/certs/ca-certificates.crt", root / "/etc/authorities.crt")
        (root / "/etc/pip.conf").write_text("[global]\ncert = /etc/authorities.crt\n")
        command = command.replace("sudo ", "").replace("apt install", "apt-get install --yes --no-install-recommends")
        if (done := root.try_to("sh", "-c", command)).returncode:
            assert "externally-managed-environment" not in done.stderr
            pytest.skip(f"nothing can be had from the package index here: {done.stderr[-300:]}")
        assert not re.search(NO_APPRISE, root.run("stadimeter", "check", CONFIGURATION))

    def test_libraries_are_its_own_and_the_systems_are_seen_behind_them(self, root):
        for module in ("libcamera", "numpy"):
            (root / "/usr/lib/python3/dist-packages").mkdir(exist_ok=True)
            (root / f"/usr/lib/python3/dist-packages/{module}.py").write_text("")
        found = root.run(
            f"{HOME}/current/bin/python3", "-c", "import libcamera, numpy; print(libcamera.__file__, numpy.__file__)"
        )
        theirs, ours = found.split()
        assert theirs == "/usr/lib/python3/dist-packages/libcamera.py"
        assert ours.startswith(f"{HOME}/current/lib/")

    def test_user_groups_and_configuration_are_there_and_the_example_can_be_used(self, root):
        for group in ("stadimeter", "gpio", "video", "dialout", "i2c"):
            root.run("getent", "group", group)
        assert root.run("stat", "--format=%a %U %G", CONFIGURATION) == "640 root stadimeter\n"
        root.run("stadimeter", "check", "--elsewhere", CONFIGURATION)

    def test_its_page_finds_the_run_and_checks_the_configuration(self, root, running):
        command = root.command("stadimeter", "web", CONFIGURATION, "--port", "0")
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as page:
            try:
                words = (word for line in page.stdout or () for word in line.split())
                address = next(word for word in words if word.startswith("http://")).rstrip("/")
                site = ServedPage(None, int(address.rpartition(":")[2]))
                assert b"<title>" in site.get("/").body
                assert site.get("/api/v1/session").data["run"]["is_running"]
                assert site.get("/snapshot.jpg").body.startswith(b"\xff\xd8")
                answer = site.ask("POST", "/api/v1/configuration/check", {"text": "[camera]\n"})
                assert answer.data["problems"]
            finally:
                page.terminate()
                page.communicate()

    def test_a_driver_of_ones_own_is_found_and_survives_an_upgrade(self, root, second):
        (root / HOME / "drivers").mkdir()
        (root / HOME / "drivers/my_driver.py").write_text("NAME = 'mine'")
        assert root.install(second).returncode == 0
        assert root.run(f"{HOME}/current/bin/python3", "-c", "import my_driver; print(my_driver.NAME)") == "mine\n"


class TestUpgrade:
    def test_configuration_and_state_are_kept_and_the_old_version_goes(self, root, second):
        (root / CONFIGURATION).write_text("# mine\n" + (root / CONFIGURATION).read_text())
        before = (root / CONFIGURATION).read_text()
        done = root.install(second)
        assert done.returncode == 0, done.stderr
        assert "not removed" not in done.stdout + done.stderr
        assert "Next:" not in done.stdout
        assert version(root) == full("1.1")
        assert (root / CONFIGURATION).read_text() == before
        assert left_in(root) == [full("1.1"), "bin", "current"]

    def test_the_service_is_stopped_only_for_the_moment_of_the_change(self, root, with_systemd, second):
        assert root.install(second).returncode == 0
        orders = [line for line in with_systemd.read_text().splitlines() if "is-" not in line and "udev" not in line]
        assert orders[0] == f"stop stadimeter.service with {full('1.0')}"
        assert orders[-1] == f"start --no-block stadimeter.service with {full('1.1')}"
        assert f"daemon-reload with {full('1.1')}" in orders

    def test_a_version_that_fails_its_self_test_is_not_run_and_what_runs_does_not_notice(
        self, root, running, with_systemd, broken
    ):
        unit = root / "/usr/lib/systemd/system/stadimeter.service"
        before = unit.read_bytes()
        done = root.install(broken)
        assert done.returncode == 0, done.stderr
        cause = "the library cv2 cannot be loaded: numpy.core.multiarray failed to import"
        why = f"the upgrade to stadimeter {full('1.2')} failed its self-test, and {full('1.0')} stays: {cause}"
        assert why in done.stderr
        assert version(root) == full("1.0")
        assert unit.read_bytes() == before
        assert {order.split(" with ")[0] for order in with_systemd.read_text().splitlines()} == {
            "daemon-reload",
            "control --reload",  # udev's
        }, "nothing is stopped"
        assert running.poll() is None
        root.run("stadimeter", "status", "--socket", "/run/stadimeter/appliance.sock")
        root.run("stadimeter", "reload", "--socket", "/run/stadimeter/appliance.sock")
        assert eventually(lambda: root.run(f"{HOME}/current/bin/python3", "-c", ASK_FOR_TROUBLE).strip() == why)
        assert why in root.try_to("stadimeter", "doctor", "--json").stdout

    def test_after_one_that_failed_apt_installs_on_and_the_next_good_one_takes_over(self, root, broken, second):
        apt_install = ("apt-get", "install", "--yes", "--reinstall", "--allow-downgrades")  # as the doctor's remedy
        for package, runs in ((broken, "1.0"), (broken, "1.0"), (second, "1.1")):
            root.run(*apt_install, put(root, package))
            assert root.run("dpkg", "--audit") == ""
            root.run("dpkg", "--configure", "-a")
            root.run(*apt_install, "hostname")
            assert version(root) == full(runs)
            assert ("failed its self-test" in root.try_to("stadimeter", "doctor").stdout) is (package is broken)
        assert left_in(root) == [full("1.1"), "bin", "current"]

    def test_a_first_installation_that_fails_is_a_failure(self, bare, broken, folder):
        with layered(bare.path, folder / "first-fails") as root:
            root.run("apt-get", "update")
            done = root.install(broken)
        assert done.returncode != 0
        assert "failed its self-test, and is not set up: the library cv2 cannot be loaded" in done.stderr

    def test_a_configuration_that_only_the_old_version_can_use_keeps_the_old_version(self, root, package):
        narrower = rewrite("stadimeter-*.dist-info/entry_points.txt", "led = stadimeter", "lamp = stadimeter")
        done = root.install(package("1.3", narrower))
        assert done.returncode == 0
        assert f"it cannot use {CONFIGURATION}, and the version that runs can" in done.stderr
        assert version(root) == full("1.0")

    def test_a_run_that_measures_nothing_keeps_the_old_version_and_says_why(self, root, package):
        idle = rewrite("stadimeter/__main__.py", "    gc.set_threshold(OBJECTS_TO_COLLECT)", "    raise SystemExit(0)")
        done = root.install(package("1.4", idle))
        assert done.returncode == 0
        assert f"and {full('1.0')} stays: FileNotFoundError: " in done.stderr
        assert version(root) == full("1.0")

    def test_a_system_without_a_folder_for_temporary_files_keeps_the_old_version_and_names_it(self, root, second):
        shutil.rmtree(root / "/tmp")  # noqa: S108 - of a root of its own
        done = root.try_to("dpkg", "--install", put(root, second))
        assert done.returncode == 0, done.stderr
        assert re.search(f"{re.escape(full('1.0'))} stays: mktemp: .*/tmp/.*No such file or directory", done.stderr)
        assert (status(root), version(root)) == (f"install ok installed {full('1.1')}", full("1.0"))

    def test_a_library_that_the_new_version_lacks_and_the_configuration_needs_keeps_the_old_version(self, root, second):
        (packages,) = (root / HOME / "current/lib").glob("python3*/site-packages")
        (packages / "apprise.py").touch()
        (root / CONFIGURATION).write_text(SIMULATED.read_text() + NOTIFIER)
        done = root.install(second)
        assert done.returncode == 0
        assert re.search(NO_APPRISE, done.stderr)
        assert version(root) == full("1.0")

    def test_a_configuration_that_no_version_can_use_is_a_warning(self, root, second):
        (root / CONFIGURATION).write_text("[camera]\n")
        done = root.install(second)
        assert done.returncode == 0, done.stderr
        assert "the configuration cannot be used" in done.stderr

    def test_a_package_that_is_cut_short_leaves_the_old_version_as_it_was(self, root, second, tmp_path):
        cut = tmp_path / second.name
        shutil.copy(second, cut)
        os.truncate(cut, second.stat().st_size * 2 // 3)
        assert root.try_to("dpkg", "--install", put(root, cut)).returncode != 0
        assert status(root) == f"install ok installed {full('1.0')}"
        assert left_in(root) == [full("1.0"), "bin", "current"]
        assert root.run("dpkg", "--verify", "stadimeter") == ""
        root.run("stadimeter", "--version")

    def test_a_full_disk_is_said_before_anything_is_touched(self, root, second):
        with small_disk(root, "/opt", "350m"):
            done = root.install(second)
            assert done.returncode != 0
            assert "/opt has" in done.stderr
            assert "MB free, and it needs" in done.stderr
            assert status(root) == f"install ok installed {full('1.0')}"
            assert left_in(root) == [full("1.0"), "bin", "current"]
            root.run("stadimeter", "--version")

    def test_a_version_that_would_forget_the_alarms_of_a_later_one_is_refused(self, root, package, first, request):
        assert root.install(package("2.0", LATER_STATE)).returncode == 0
        running = request.getfixturevalue("running")
        done = root.install(first)
        assert done.returncode != 0
        assert f"{STATE} was written by a later version" in done.stderr
        assert status(root) == f"install ok installed {full('2.0')}"
        assert version(root) == full("2.0")
        assert running.poll() is None


class TestRemoval:
    @pytest.fixture
    def pins(self, root: DebianRoot) -> Path:
        """Pretend that there are pins; return the file in which they were driven."""
        program = root / "/usr/bin/pinctrl"
        program.write_text('#!/bin/sh\necho "$*" >>/root/pins.log\n')
        program.chmod(0o755)
        (root / "/etc/stadimeter/safe-outputs.conf").write_text("pin 18\n")
        return root / "/root/pins.log"

    def test_outputs_are_switched_off_and_what_is_the_users_is_left(self, root, pins):
        (root / STATE).parent.mkdir(exist_ok=True)
        (root / STATE).touch()
        done = root.try_to("apt-get", "remove", "--yes", "stadimeter")
        assert done.returncode == 0, done.stderr
        assert pins.read_text() == "set 18 op dl\n"
        assert "not removed" not in done.stdout + done.stderr
        assert (root / CONFIGURATION).exists()
        assert (root / STATE).exists()
        assert not os.path.lexists(root / HOME)

    def test_a_purge_leaves_nothing(self, root, pins):
        root.run("apt-get", "purge", "--yes", "stadimeter")
        left = root.run("find", "/", "-xdev", "-path", "/root", "-prune", "-o", "-iname", "*stadimeter*", "-print")
        assert left == ""
        assert root.try_to("getent", "passwd", "stadimeter").returncode != 0
        assert root.try_to("getent", "group", "stadimeter").returncode != 0
