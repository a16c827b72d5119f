"""What is installed is whole: the demonstration works without the checkout."""

import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.long
def test_the_wheel_holds_the_demonstration_and_declares_every_driver(tmp_path):
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", tmp_path, ROOT]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("stadimeter-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        demo = archive.read("stadimeter/configurations/demo.toml").decode()
        assert "stadimeter/py.typed" in archive.namelist()
        examples = {path.name for path in (ROOT / "config").glob("*.toml")}
        assert {f"stadimeter/configurations/{name}" for name in examples} <= set(archive.namelist())
        (metadata,) = [name for name in archive.namelist() if name.endswith("entry_points.txt")]
        assert "vibration-motor" in archive.read(metadata).decode()
    assert tomllib.loads(demo) == tomllib.loads((ROOT / "config" / "demo.toml").read_text())
