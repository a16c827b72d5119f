"""Mutations of files: what a bad disk, a bad editor and a bad intention make of them. Each seed makes the same ones."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Callable

import pytest

Mutate = Callable[[random.Random, bytes], bytes]

NASTY = [
    b"9" * 5000, b"-" + b"9" * 5000, b"0x" + b"f" * 5000, b"1e" + b"9" * 5000, b"0." + b"1" * 5000, b"1" + b"0" * 30,
    b"9223372036854775807", b"-9223372036854775808", b"18446744073709551616", b"1e308", b"-1e308", b"1e-320", b"inf",
    b"-inf", b"nan", b"NaN", b"Infinity", b"-0.0", b"0", b"-1", b"true", b"null", b'""', b"''", b'"""', b"1979-05-27",
    b"1979-05-27T07:32:00Z", b"07:32:00", b"9999-99-99", b"[" * 10_000, b"[" * 10_000 + b"]" * 10_000, b'{"a":' * 5000,
    b"{a=" * 3000, b"[[[]]]", b"{}", b"[]", b"a." * 2000, b"[a]\n" * 300, b'"' + b"a" * 20_000 + b'"', b'"\\ud800"',
    b'"\\u0000"', b'"/dev/zero"', b'"/dev/stdin"', b'"~nobody-of-that-name/x"', b'"' + b"n" * 300 + b'"', b'"**/*"',
    b'"1e308 km"', b'"1e999 m"', b'"' + b"9" * 5000 + b' s"', b'"-1 m"', b'"0 s"', b'"1e-300 m"', b'"1e300 h"',
    b'"1e300 Hz"', b'"1e-300 Hz"', b'"1 m2"', b'"\xff\xfe"', b"\xed\xa0\x80", b"\0", b"\0" * 4096, b"\xef\xbb\xbf",
    b"\xff\xfe", b"\r", b"\r\n", b"\x1b[2J", b"\xe2\x80\xae", b"#", b"\\", b"\n" * 5000,
]  # fmt: skip
"""Values that no program expects where it reads another one."""


def flipped(rng: random.Random, data: bytes) -> bytes:
    """Return the data with one byte changed."""
    changed = bytearray(data)
    changed[rng.randrange(len(changed))] ^= rng.randrange(1, 256)
    return bytes(changed)


def _any_part(rng: random.Random, data: bytes) -> tuple[int, int]:
    begin = rng.randrange(len(data))
    return begin, min(len(data), begin + rng.choice((1, 2, 4, 16, 64, 1024)))


def _value(rng: random.Random, data: bytes) -> tuple[int, int]:
    """Return where a value stands: from an equals sign, a colon or a comma to the end of its line or what closes it."""
    marks = [at for at, byte in enumerate(data) if byte in b"=:,["]
    begin = rng.choice(marks) + 1 if marks else rng.randrange(len(data))
    end = next((at for at in range(begin, len(data)) if data[at] in b"\n,]}"), len(data))
    return begin, end


def mutated(rng: random.Random, data: bytes) -> bytes:
    """Return the data with one to three things wrong in them."""
    for _ in range(rng.choice((1, 1, 2, 3))):
        if not data:
            return data
        kind = rng.randrange(6)
        begin, end = _value(rng, data) if kind == 5 else _any_part(rng, data)
        if kind == 0:
            data = flipped(rng, data)
        elif kind == 1:
            data = data[:begin] + data[end:]
        elif kind == 2:
            data = data[:end] + data[begin:end] * rng.choice((1, 2, 50)) + data[end:]
        elif kind == 3:
            other = rng.randrange(len(data))
            data = data[:begin] + data[other : other + end - begin] + data[end:]
        elif kind == 4:
            data = data[:begin] + rng.choice(NASTY) + data[begin:]
        else:
            data = data[:begin] + rng.choice(NASTY) + data[end:]
    return data


@pytest.fixture(scope="session")
def mutate() -> Mutate:
    return mutated


@pytest.fixture(scope="session")
def flip() -> Mutate:
    return flipped


def _run_measured(*arguments: object) -> tuple[int, str, int]:
    """Run a command; return its exit code, what it said on standard error, and its largest memory in kB."""
    measured = (
        "import resource, subprocess, sys\n"
        "done = subprocess.run([sys.executable, '-m', 'stadimeter', *sys.argv[1:]], stdin=subprocess.DEVNULL)\n"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)\n"
        "sys.exit(done.returncode)"
    )
    done = subprocess.run(
        [sys.executable, "-c", measured, *map(os.fsencode, map(str, arguments))],
        capture_output=True, check=False, timeout=120,
    )  # fmt: skip
    return done.returncode, done.stderr.decode(), int(done.stdout.split()[-1])


@pytest.fixture(scope="session")
def run_measured() -> Callable[..., tuple[int, str, int]]:
    return _run_measured
