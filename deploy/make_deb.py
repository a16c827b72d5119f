"""Makes the Debian package: ``make deb``, or ``python deploy/make_deb.py --release trixie --arch arm64``.

It needs pip, dpkg-deb and a network, no root and no machine of the release: pip gathers wheels that are built for it.
The package has an environment of its own, in a folder named after its version; docs/decisions/package.md says why.
Which libraries it has is in a lock for each release, `debian/*.lock`, which ``make lock`` writes.
"""

from __future__ import annotations

import argparse
import gzip
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path

import package_docs
from msgspec import Struct

from stadimeter.app.persistence.alarm_store import APPLICATION_ID, FORMAT
from stadimeter.config.extras import OLDEST_PICAMERA2

DEPLOY = Path(__file__).resolve().parent
CHECKOUT = DEPLOY.parent
PYPROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text())
HOME = "opt/stadimeter"
EXTRAS = ("metrics", "record", "sun", "web")
NOT_PACKED = ("lz4", "setuptools", "zstandard")
"""What libraries ask for and we do not use, or have from Debian."""
WHEELS_FOR = {"amd64": "x86_64", "arm64": "aarch64"}
"""How wheels name an architecture of Debian."""

BYTE_CODE_SHARE = 1.5
"""Of the size of Python's sources, in whole blocks; it is compiled on installation."""

MARGIN_KB = 20_000
LAUNCHER = f"""\
#!/{HOME}/current/bin/python3 -s
from stadimeter.__main__ import main

main()
"""
SYSTEM_FILES = {
    "stadimeter.service": "usr/lib/systemd/system/stadimeter.service",
    "stadimeter-web.service": "usr/lib/systemd/system/stadimeter-web.service",
    "avahi/stadimeter.service": "usr/share/stadimeter/avahi.service",
    "99-stadimeter.rules": "usr/lib/udev/rules.d/99-stadimeter.rules",
    "modules-load.conf": "usr/lib/modules-load.d/stadimeter.conf",
}
"""Files of this folder that the system looks for in one place only."""

CONFIGURATION = "etc/stadimeter/appliance.toml"
EXAMPLES = "usr/share/stadimeter/examples"
NOT_FOR_USERS = ("benchmarks", "decisions", "recipes")

DRIVES_PINS = "raspi-utils | gpiod"
"""Where there is raspi-utils, on Raspberry Pi OS, it is installed for its pinctrl: Debian has the other one only, which
shows who holds a pin. Pins are switched off without either, too: see `stadimeter.watchdog.gpio`."""

LIBRARIES = "python3-zstandard, liblapack3 | liblapack.so.3, libblas3 | libblas.so.3"
"""What is a tenth of the size in Debian: its zstandard has no debug symbols, its LAPACK serves OpenCV. Where there is a
picamera2, LAPACK is there."""

LINKS = {
    f"{HOME}/bin/stadimeter": "current/bin/stadimeter",
    "usr/bin/stadimeter": "current/bin/stadimeter",
    "usr/lib/stadimeter/safe-outputs": "current/libexec/safe-outputs",
}
"""What belongs to the version that runs, by a name that stays; `current` is a link that installation makes."""

NEVER_USED = (
    "bin",
    "*.dist-info/RECORD",  # as in Debian's packages: files are dpkg's
    "*.dist-info/direct_url.json",  # names a temporary folder
    "cv2/data/*.xml",  # trained classifiers
    "opencv_python_headless.libs/libgfortran*",  # for the OpenBLAS of the wheel
    "opencv_python_headless.libs/libquadmath*",
    "pydantic/v1",
    "pygments/lexers/[!_s]*.py",  # for languages; rich needs special.py
    "pygments/lexers/s[!p]*.py",
    "pygments/lexers/_[!_m]*.py",
    "numpy/distutils",
    "numpy/f2py",
    "numpy/*core/include",
    "numpy/**/*.a",
    "numpy/**/_simd.*.so",  # for its tests
    "**/tests",
    "**/__pycache__",
    "**/*.pyi",
)


class Release(Struct, frozen=True, kw_only=True):
    """A release of Debian, and of Raspberry Pi OS.

    Attributes:
        suffix: Of the package's version, so that the next release's is the higher one.
        python: Of the release, which the environment is for.
        glibc: Minor version, from which follows which wheels run there.
        libraries: Besides those of pyproject.toml. The system's packages must work with the numpy that is here.
        recommends: What Raspberry Pi OS has and no wheel gives: a library for pins.
    """

    suffix: str
    python: str
    glibc: int
    libraries: tuple[str, ...]
    recommends: str = "raspi-utils"


RELEASES = {
    "bookworm": Release(
        suffix="deb12",
        python="3.11",
        glibc=36,
        libraries=("numpy<2", "opencv-python-headless<4.12", "lgpio>=0.2.2"),  # picamera2 there is built for numpy 1
    ),
    "trixie": Release(
        suffix="deb13", python="3.13", glibc=41, libraries=("numpy>=2.2",), recommends="raspi-utils, python3-lgpio"
    ),
}


class Target(Struct, frozen=True, kw_only=True):
    """The package to be made: its release, its architecture as Debian names it, and the version of the program."""

    release: Release
    architecture: str
    program_version: str

    @property
    def version(self) -> str:
        """The package's version."""
        return f"{self.program_version}+{self.release.suffix}"

    @property
    def python(self) -> str:
        """The interpreter's name, which is its package's too."""
        return f"python{self.release.python}"

    @property
    def environment(self) -> str:
        """The folder of the environment on the target."""
        return f"{HOME}/{self.version}"


def lock() -> None:
    """Choose the libraries of each release anew, and what builds the wheel, from the ranges of pyproject.toml."""
    for release in RELEASES.values():
        options = [f"--extra={extra}" for extra in EXTRAS] + [f"--no-emit-package={each}" for each in NOT_PACKED]
        _compile(release.suffix, release.libraries, "pyproject.toml", f"--python-version={release.python}", *options)
    _compile("build", PYPROJECT["build-system"]["requires"], f"--python-version={RELEASES['bookworm'].python}")


def _compile(name: str, ranges: Sequence[str], *arguments: str) -> None:
    """Write a lock by uv, which takes the markers of the target; pip takes those of the Python that it runs with."""
    command = [sys.executable, "-m", "uv", "pip", "compile", "-", *arguments, f"--output-file={_lock(name)}", "--quiet"]
    command += ["--upgrade", "--generate-hashes", "--no-annotate", "--custom-compile-command=make lock"]
    # The oldest glibc of a release. The lock has the hashes of the other architectures, too.
    command += ["--only-binary=:all:", "--python-platform=aarch64-manylinux_2_36"]
    subprocess.run(command, input="\n".join(ranges), text=True, cwd=CHECKOUT, check=True)  # noqa: S603


def _lock(name: str) -> Path:
    return DEPLOY / f"debian/{name}.lock"


def gather(target: Target, folder: Path) -> None:
    """Put the program and its libraries into a folder, as they are wanted on the target."""
    into = ("--no-deps", "--no-compile", "--target", folder)
    libraries = _lock(target.release.suffix)
    _pip("install", *into, *_platform(target), "--require-hashes", "--requirement", libraries)
    with tempfile.TemporaryDirectory() as built:
        _pip("wheel", "--no-deps", "--build-constraint", _lock("build"), "--wheel-dir", built, CHECKOUT)
        _pip("install", *into, *Path(built).glob("*.whl"))
    for pattern in NEVER_USED:
        for path in tuple(folder.glob(pattern)):
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)


def _platform(target: Target) -> list[str]:
    machine = WHEELS_FOR[target.architecture]
    names = [f"manylinux_2_{minor}_{machine}" for minor in range(target.release.glibc, 16, -1)]
    names += [f"manylinux2014_{machine}", f"linux_{machine}"]
    return [
        *("--only-binary=:all:", "--implementation=cp", f"--python-version={target.release.python}"),
        *(f"--platform={name}" for name in names),
    ]


def _pip(*arguments: str | Path) -> None:
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", *map(str, arguments), "-qq"]
    subprocess.run(command, check=True)  # noqa: S603


def pack(target: Target, libraries: Path, output: Path, *, compression: str = "zstd") -> Path:
    """Make the package from what `gather` gathered, and return its path.

    Args:
        libraries: On the same file system as the temporary folder, it is linked and not copied.
        output: The folder for the package.
    """
    output.mkdir(parents=True, exist_ok=True)
    package = output / f"stadimeter_{target.version}_{target.architecture}.deb"
    with tempfile.TemporaryDirectory(dir=output) as folder:
        root = Path(folder, "root")
        root.mkdir(mode=0o755)
        _lay_out(target, libraries, root)
        _describe(target, root)
        # One thread: more make another file.
        command = ["dpkg-deb", "--root-owner-group", "--threads-max=1", f"-Z{compression}", "--build", root, package]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)  # noqa: S603
    return package


def _lay_out(target: Target, libraries: Path, root: Path) -> None:
    environment = root / target.environment
    packages = environment / "lib" / target.python / "site-packages"
    shutil.copytree(libraries, packages, copy_function=_link)
    _take_lapack_of_debian(packages, WHEELS_FOR[target.architecture])
    (packages / "drivers.pth").write_text(f"/{HOME}/drivers\n")
    (environment / "version").write_text(f"{target.version}\n")
    # The system's packages are seen behind ours: libcamera and picamera2 come with the system only.
    (environment / "pyvenv.cfg").write_text(
        f"home = /usr/bin\ninclude-system-site-packages = true\nexecutable = /usr/bin/{target.python}\n"
    )
    _point(environment / "bin/python3", f"/usr/bin/{target.python}")
    _write(environment / "bin/stadimeter", LAUNCHER, 0o755)
    for name in ("debian/self_test.py", "debian/self-test.toml", "safe-outputs"):
        mode = 0o755 if name == "safe-outputs" else 0o644
        _write(environment / "libexec" / Path(name).name, (DEPLOY / name).read_text(), mode)
    for name, place in SYSTEM_FILES.items():
        # Once for the system, and once for the version: when the next one fails its self-test, it is put back.
        for top in (root, environment / "share/system"):
            _write(top / place, (DEPLOY / name).read_text())
    for link, place in LINKS.items():
        _point(root / link, f"/{HOME}/{place}")
    _write(root / CONFIGURATION, (CHECKOUT / "config/appliance.toml").read_text())
    for example in (
        *(CHECKOUT / "config").glob("*.toml"),
        *DEPLOY.glob("prometheus/*.yml"),
        *DEPLOY.glob("grafana/*.json"),
        *DEPLOY.glob("homeassistant/*"),
    ):
        _write(root / EXAMPLES / example.name, example.read_text())
    for example in (DEPLOY / "mosquitto").iterdir():
        mode = 0o644 if example.suffix else 0o755
        _write(root / EXAMPLES / "mosquitto" / example.name, example.read_text(), mode)
    _document(target, root / "usr/share")
    for shell, place in package_docs.COMPLETIONS.items():
        _write(root / place, package_docs.completion(shell))


def _take_lapack_of_debian(packages: Path, machine: str) -> None:
    """Link the OpenBLAS of OpenCV's wheel, 38 MB on amd64, to the library that has the same functions in Debian."""
    for library in tuple(packages.glob("opencv_python_headless.libs/libopenblas*")):
        library.unlink()
        _point(library, f"/usr/lib/{machine}-linux-gnu/liblapack.so.3")


def _document(target: Target, share: Path) -> None:
    folder = share / "doc/stadimeter"
    for page in (CHECKOUT / "docs").rglob("*.md"):
        part = page.relative_to(CHECKOUT / "docs")
        if part.parts[0] not in NOT_FOR_USERS:
            _write(folder / part, page.read_text())
    _point(folder / "examples", "../../stadimeter/examples")
    copyright_text = (DEPLOY / "debian/copyright").read_text()
    licence = "\n".join(f" {line or '.'}" for line in (CHECKOUT / "LICENSE").read_text().splitlines())
    _write(folder / "copyright", copyright_text.replace("@LICENSE@", licence))
    maintainer = re.findall("^Maintainer: (.*)$", (DEPLOY / "debian/control").read_text(), re.MULTILINE)[0]
    changes = (CHECKOUT / "CHANGELOG.md").read_text()
    _write(folder / "changelog.gz", package_docs.changelog(target.version, maintainer, changes))
    page = gzip.compress(package_docs.man_page(target.program_version).encode(), mtime=0)
    _write(share / "man/man1/stadimeter.1.gz", page)


def _describe(target: Target, root: Path) -> None:
    sources_kb = sum(path.stat().st_size for path in root.rglob("*.py")) // 1024
    installed_kb = _size_kb(root) + round(BYTE_CODE_SHARE * sources_kb)
    values = {
        "VERSION": target.version,
        "ARCHITECTURE": target.architecture,
        "INSTALLED_KB": installed_kb,
        "NEEDED_KB": installed_kb + MARGIN_KB,
        "PYTHON": target.python,
        "DEPENDS": f"{target.python}, libc6 (>= 2.{target.release.glibc}), {LIBRARIES}, passwd, {DRIVES_PINS}",
        "PICAMERA2": OLDEST_PICAMERA2,
        "RECOMMENDS": target.release.recommends,
        "STATE_FORMAT": FORMAT,
        "APPLICATION_ID": APPLICATION_ID,
    }
    for name in ("control", "preinst", "postinst", "prerm", "postrm"):
        text = (DEPLOY / "debian" / name).read_text()
        for key, value in values.items():
            text = text.replace(f"@{key}@", str(value))
        _write(root / "DEBIAN" / name, text, 0o644 if name == "control" else 0o755)
    _write(root / "DEBIAN/conffiles", f"/{CONFIGURATION}\n")


def _size_kb(folder: Path) -> int:
    """Return what files take on a disk, in whole blocks of 4 KiB."""
    return sum(-(-path.lstat().st_size // 4096) * 4 for path in folder.rglob("*"))


def _write(path: Path, content: str | bytes, mode: int = 0o644) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    path.chmod(mode)


def _point(link: Path, target: str) -> None:
    link.parent.mkdir(parents=True, exist_ok=True)
    link.symlink_to(target)


def _link(source: str, copy: str) -> None:
    try:
        os.link(source, copy)
    except OSError:
        shutil.copy2(source, copy)


def this_release() -> str:
    """Return the release of this computer if there is a package for it, else the newest one that there is."""
    name = platform.freedesktop_os_release().get("VERSION_CODENAME", "")
    return name if name in RELEASES else list(RELEASES)[-1]


def this_architecture() -> str:
    """Return the architecture of this computer, as Debian names it."""
    machine = platform.machine()
    return next((name for name, wheels in WHEELS_FOR.items() if wheels == machine), "arm64")


def main() -> None:
    """Make a package and say where it is."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--release", choices=RELEASES, default=this_release())
    parser.add_argument("--arch", choices=WHEELS_FOR, default=this_architecture())
    parser.add_argument("--version", default=PYPROJECT["project"]["version"], help="as Debian shall compare it")
    parser.add_argument("--output", type=Path, default=CHECKOUT / "dist", help="folder for the package")
    given = parser.parse_args()
    os.umask(0o022)
    target = Target(release=RELEASES[given.release], architecture=given.arch, program_version=given.version)
    with tempfile.TemporaryDirectory() as folder:
        libraries = Path(folder, "libraries")
        gather(target, libraries)
        package = pack(target, libraries, given.output)
    print(f"{package}: {package.stat().st_size / 1e6:.0f} MB; sudo apt install {os.path.relpath(package)}")


if __name__ == "__main__":
    main()
