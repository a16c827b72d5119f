"""What an encoding lacks is written in characters that it has, by one table."""

import codecs
import subprocess
import sys
from pathlib import Path

import pytest

from stadimeter.cli.main import PLAIN, PLAIN_ERRORS, plain


def test_what_ascii_lacks_is_written_plainly() -> None:
    for words, written in [
        ("2.43 m ± 0.04 at 3°, σ ≤ 1 …", "2.43 m +- 0.04 at 3 deg, sigma <= 1 ..."),
        ("−3 µs → “x” ┏─┓│", '-3 us -> "x" +-+|'),
        ("日本", "\\u65e5\\u672c"),
        ("café.png caf\udce9.png", "caf\\xe9.png caf\\udce9.png"),
    ]:
        assert words.encode("ascii", PLAIN_ERRORS).decode("ascii") == written


def test_what_an_encoding_has_stays_as_it_is() -> None:
    assert "± → é".encode("latin-1", PLAIN_ERRORS) == "± -> é".encode("latin-1")


def test_every_stand_in_is_ascii() -> None:
    assert all(word.isascii() for word in PLAIN.values())
    assert plain("a") == "a"


def test_what_cannot_be_read_stays_an_error() -> None:
    with pytest.raises(UnicodeDecodeError):
        codecs.decode(b"\xff", "ascii", PLAIN_ERRORS)


@pytest.mark.long
def test_commands_print_no_more_than_ascii_where_there_is_no_more(tmp_path: Path, pytestconfig: pytest.Config) -> None:
    def written(*command: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "stadimeter", *command],
            capture_output=True,
            env={"PYTHONIOENCODING": "ascii", "LANG": "C", "STADIMETER_PROGRESS": "off"},
            check=True,
            cwd=tmp_path,
        )
        assert done.stderr == b""
        return done.stdout.decode("ascii")

    shown = {
        "help": written("measure", "--help"),
        "check": written("check", str(pytestconfig.rootpath / "config" / "demo.toml")),
        "demo": written("demo", "--seconds=2", "--speed=0", "--journal=run.jsonl"),
        "replay": written("replay", "run.jsonl"),
        "explain": written("explain", "near", "--journal=run.jsonl"),
    }
    assert [name for name, words in shown.items() if "\\u" in words or "\\x" in words] == []
    assert "56 deg wide" in shown["check"]
    assert " m +- 0." in shown["demo"]
    assert " m +- 0." in shown["explain"]
