"""Files that ask for more than there is: each command refuses them in one line, and needs no more memory than ever.

Each is given to the real command. Time is not asserted, since machines are shared: a command that hangs is ended by the
limit of the test.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

from stadimeter.cameras.image_files import load_picture
from stadimeter.config.files import CONFIGURATION_MAX_BYTES
from stadimeter.errors import PictureError

MEMORY_MAX_KB = 300_000
CAMERA = "width_px = 640\nheight_px = 480\nfx_px = 600.0\n"

Run = Callable[..., tuple[int, str, int]]
Bomb = Callable[[Path], object]


def pipe(path: Path) -> None:
    os.mkfifo(path)


def loop(path: Path) -> None:
    path.symlink_to(path)


def endless(path: Path) -> None:
    path.symlink_to("/dev/zero")


def gigantic(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(300_000_000)


def text_of(text: str) -> Bomb:
    return lambda path: path.write_text(text, encoding="utf-8")


def png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width: int, height: int, rows: bytes) -> bytes:
    header = png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + png_chunk(b"IDAT", rows) + png_chunk(b"IEND", b"")


def many_pixels(path: Path) -> None:
    packer = zlib.compressobj(9)
    row = bytes(1 + 3 * 40_000)
    path.write_bytes(png(40_000, 2_000, b"".join(packer.compress(row) for _ in range(2_000)) + packer.flush()))


def lying_header(path: Path) -> None:
    path.write_bytes(b"P6\n500000 490000\n255\n" + bytes(10))


FILES: dict[str, Bomb] = {"pipe": pipe, "loop": loop, "endless": endless, "gigantic": gigantic, "folder": Path.mkdir}
TEXTS: dict[str, Bomb] = {
    **FILES,
    "digits": text_of(f"{CAMERA}x = {'9' * 5000}\n"),
    "hexadecimal digits": text_of(f"{CAMERA}x = 0x{'f' * 5000}\n"),
    "brackets": text_of("x = " + "[" * 100_000),
    "many keys": text_of("".join(f"a{number} = 1\n" for number in range(CONFIGURATION_MAX_BYTES // 13))),
    "wide": text_of(f"width_px = {10**12}\nheight_px = {10**12}\nfx_px = 1e12\n"),
}
PICTURES: dict[str, Bomb] = {**FILES, "pixels": many_pixels, "lying header": lying_header}
JOURNALS: dict[str, Bomb] = {
    **FILES,
    "brackets": text_of("[" * 1_000_000),
    "brackets in a header": text_of('{"stadimeter_journal":1,"x":' + "[" * 100_000 + "]" * 100_000 + "}\n"),
    "digits": text_of('{"stadimeter_journal":' + "9" * 5000 + "}\n"),
    "no text": lambda path: path.write_bytes(b'{"stadimeter_journal":1,"version":"\xff"}\n'),
}


def assert_refused(run_measured: Run, path: Path, *arguments: object, lines: int = 1) -> None:
    code, said, memory_kb = run_measured(*arguments)
    assert (code, "Traceback" in said) == (2, False), said
    assert memory_kb <= MEMORY_MAX_KB
    assert path.name in said
    assert len(said.splitlines()) <= lines, said


@pytest.mark.long
@pytest.mark.parametrize("kind", TEXTS)
def test_a_configuration_that_asks_for_too_much_is_refused(tmp_path: Path, run_measured: Run, kind: str) -> None:
    path = tmp_path / "bomb.toml"
    TEXTS[kind](path)
    assert_refused(run_measured, path, "run", path, lines=101)
    assert_refused(run_measured, path, "check", path, lines=410)


@pytest.mark.long
@pytest.mark.parametrize("kind", TEXTS)
def test_a_camera_file_that_asks_for_too_much_is_refused(tmp_path: Path, run_measured: Run, kind: str) -> None:
    path = tmp_path / "bomb.toml"
    TEXTS[kind](path)
    assert_refused(run_measured, path, "measure", "picture.png", "--camera", path, "--sheet", "11in,8.5in", lines=101)


@pytest.mark.long
@pytest.mark.vision
@pytest.mark.parametrize("kind", sorted(PICTURES))
def test_a_picture_that_asks_for_too_much_is_refused_or_harmless(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "bomb.png"
    PICTURES[kind](path)
    with pytest.raises(PictureError, match=r"bomb\.png"):
        load_picture(path)


@pytest.mark.long
@pytest.mark.parametrize("kind", PICTURES)
def test_measuring_such_a_picture_takes_no_more_memory(tmp_path: Path, run_measured: Run, kind: str) -> None:
    path, camera = tmp_path / "bomb.png", tmp_path / "camera.toml"
    camera.write_text("width_px = 1000\nheight_px = 1000\nfx_px = 900.0\n", encoding="utf-8")
    PICTURES[kind](path)
    code, said, memory_kb = run_measured("measure", path, "--camera", camera, "--sheet", "11in,8.5in")
    assert code in {1, 2}
    assert "Traceback" not in said
    assert memory_kb <= MEMORY_MAX_KB


@pytest.mark.long
@pytest.mark.parametrize("kind", JOURNALS)
def test_a_journal_that_asks_for_too_much_is_refused(tmp_path: Path, run_measured: Run, kind: str) -> None:
    path = tmp_path / "bomb.jsonl"
    JOURNALS[kind](path)
    assert_refused(run_measured, path, "replay", path)


@pytest.mark.long
@pytest.mark.parametrize("command", [("check",), ("check", "--json"), ("run",), ("replay",), ("test",)])
def test_a_name_that_is_no_text_can_be_shown(tmp_path: Path, run_measured: Run, command: tuple[str, ...]) -> None:
    path = tmp_path / os.fsdecode(b"name\xff.toml")
    path.write_bytes(b"\xff")
    code, said, _ = run_measured(*command, path)
    assert code == 2
    assert "Traceback" not in said
    assert r"name\udcff.toml" in said or "--json" in command
