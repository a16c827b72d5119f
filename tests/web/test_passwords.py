"""Passwords: their file, the command that writes it, and how often one may be tried."""

import json
import os
import pty
import stat
import subprocess
import sys

import pytest

from stadimeter.errors import PageError
from stadimeter.web.passwords import ADDRESSES_MAX, FORGOTTEN_S, FREE, MAX_WAIT_S, Attempts, PasswordFile
from stadimeter.web.routes import Right
from support.page import OPERATE, READ, quicken

# The file of the passwords, and the command that writes it.


@pytest.fixture
def file(tmp_path, monkeypatch):
    quicken(monkeypatch)
    return PasswordFile(tmp_path / "page.passwords")


def test_without_a_file_there_is_no_password(file):
    assert file.passwords() is None


def test_each_password_opens_its_own_right_and_no_other_opens_any(file):
    file.set("operate", OPERATE)
    file.set("read", READ)
    passwords = file.passwords()
    assert [passwords.right_of(each) for each in (OPERATE, READ, OPERATE + " ", "", "\ud800")] == [
        Right.OPERATE,
        Right.READ,
        Right.OPEN,
        Right.OPEN,
        Right.OPEN,
    ]


def test_the_file_is_for_its_owner_alone_and_holds_no_password(file):
    file.set("operate", OPERATE)
    assert stat.S_IMODE(file.path.stat().st_mode) == 0o600
    assert OPERATE not in file.path.read_text()
    assert [path.name for path in file.path.parent.iterdir()] == [file.path.name]


@pytest.mark.skipif(os.getuid() != 0, reason="only root gives files away")
def test_root_writes_it_for_the_owner_of_the_folder(file):
    os.chown(file.path.parent, 4711, 4712)
    file.set("operate", OPERATE)
    assert (file.path.stat().st_uid, file.path.stat().st_gid) == (4711, 4712)


def test_a_new_password_brings_a_new_key_and_is_seen_at_once(file):
    file.set("operate", OPERATE)
    before = file.passwords()
    PasswordFile(file.path).set("operate", "another one")
    assert file.passwords().key != before.key
    assert file.passwords().right_of("another one") is Right.OPERATE
    assert file.passwords().right_of(OPERATE) is Right.OPEN


@pytest.mark.parametrize("password", ["seven77", "x" * 501])
def test_a_password_has_a_length_that_can_be_used(file, password):
    with pytest.raises(PageError, match="8 to 500"):
        file.set("operate", password)


def test_the_two_rights_cannot_have_the_same_password(file):
    file.set("operate", OPERATE)
    with pytest.raises(PageError, match="the other's"):
        file.set("read", OPERATE)


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"scrypt": 1}', '{"scrypt": {"n": "x"}}'])
def test_a_file_that_is_none_lets_nobody_in(file, text):
    file.path.write_text(text)
    with pytest.raises(PageError, match="no password file"):
        file.passwords()


@pytest.mark.parametrize(("right", "options"), {"operate": (), "read": ("--read",)}.items())
def test_the_command_asks_twice_and_shows_nothing(tmp_path, right, options):
    """At a real terminal: what is typed must not be echoed."""
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "stadimeter", "web", str(tmp_path / "room.toml"), "--set-password", *options]
    with subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True) as process:
        os.close(theirs)
        shown = b""
        asked_first = {"operate": b"operating: ", "read": b"watching: "}[right]
        for asked in (asked_first, b"Once more: "):
            while asked not in shown:
                shown += os.read(ours, 1000)
            os.write(ours, OPERATE.encode() + b"\n")
        try:
            while more := os.read(ours, 1000):
                shown += more
        except OSError:  # the other end is closed
            pass
    os.close(ours)
    assert process.returncode == 0
    assert OPERATE.encode() not in shown
    assert b"sessions have ended" in shown
    assert b"started again" in shown  # what listens on the loopback goes on to
    assert set(json.loads((tmp_path / "room.passwords").read_text())) == {"scrypt", "salt", "key", right}


# How often a password may be tried.


class Clock:
    now_s = 1000.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def attempts(clock):
    return Attempts(clock)


def wait_s(attempts, address="192.168.1.7"):
    """Try once, and return how long it is too early."""
    try:
        attempts.begin(address)
    except PageError as error:
        return error.details["wait_s"]
    return 0


def test_a_few_wrong_passwords_cost_no_time_and_each_further_one_twice_the_wait(attempts, clock):
    assert [wait_s(attempts) for _ in range(FREE)] == [0] * FREE
    waits = []
    for _ in range(12):
        waits.append(wait_s(attempts))
        clock.now_s += waits[-1]
        assert wait_s(attempts) == 0
    assert waits[:3] == [10, 20, 40]
    assert max(waits) == waits[-1] == MAX_WAIT_S


def test_who_knows_the_password_starts_afresh(attempts):
    for _ in range(FREE):
        attempts.begin("192.168.1.7")
        attempts.succeeded("192.168.1.7")
    assert [wait_s(attempts) for _ in range(FREE + 1)] == [0] * FREE + [10]


def test_what_went_wrong_a_day_ago_counts_no_more(attempts, clock):
    assert [wait_s(attempts) for _ in range(FREE + 1)][-1] == 10
    clock.now_s += 10 + FORGOTTEN_S + 1
    assert [wait_s(attempts) for _ in range(FREE + 1)] == [0] * FREE + [10]


def stranger(number):
    return f"10.{number // 65536}.{number // 256 % 256}.{number % 256}"


def test_memory_is_bounded(attempts):
    for number in range(3 * ADDRESSES_MAX):
        assert wait_s(attempts, stranger(number)) == 0
        if number % 2:
            attempts.succeeded(stranger(number))
    assert ADDRESSES_MAX - 1 <= len(attempts._failures) <= ADDRESSES_MAX
