"""What is installed is whole: the demonstration works without the checkout, and the package index shows a README."""

import email
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LARGEST_WHEEL = 1_950_000
"""In bytes; it is downloaded over slow lines to Raspberry Pis, beside OpenCV."""

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", folder, ROOT]
    subprocess.run(build, check=True, capture_output=True)
    (path,) = folder.glob("stadimeter-*.whl")
    return path


def read(wheel, ending):
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(ending)]
        return archive.read(name).decode()


def test_it_declares_every_driver_and_its_types(wheel):
    assert "vibration-motor" in read(wheel, "entry_points.txt")
    assert read(wheel, "stadimeter/py.typed") == ""


@pytest.mark.parametrize("path", sorted((ROOT / "config").glob("*.toml")), ids=lambda path: path.name)
def test_it_holds_the_example_configurations(wheel, path):
    assert tomllib.loads(read(wheel, f"stadimeter/configurations/{path.name}")) == tomllib.loads(path.read_text())


def test_it_is_small(wheel):
    assert wheel.stat().st_size <= LARGEST_WHEEL


def test_every_link_and_picture_of_its_readme_works_on_a_package_index(wheel):
    metadata = email.message_from_string(read(wheel, "METADATA"))
    repository = dict(url.split(", ") for url in metadata.get_all("Project-URL"))["Homepage"]
    owner = repository.removeprefix("https://github.com/")
    shown = re.findall(r"(!?)\[[^\]]*\]\(([^)]+)\)", metadata.get_payload())
    files = {f"{repository}/blob/main/": False, f"https://raw.githubusercontent.com/{owner}/main/": True}
    for mark, target in shown:
        (start,) = [start for start in files if target.startswith(start)]
        assert files[start] == bool(mark), target
        assert (ROOT / target.removeprefix(start).partition("#")[0]).exists(), target
    assert len(shown) > 20
