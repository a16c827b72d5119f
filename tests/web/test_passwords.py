"""The file of the passwords, and the command that writes it."""

import json
import os
import pty
import stat
import subprocess
import sys

import pytest

from stadimeter.errors import PageError
from stadimeter.web.passwords import SCRYPT, PasswordFile, place_of_passwords
from stadimeter.web.routes import Right
from support.page import OPERATE, READ, quicken


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


def test_the_hash_costs_what_is_recommended():
    assert SCRYPT["n"] * SCRYPT["r"] * SCRYPT["p"] >= 2**14 * 8 * 5


def test_the_passwords_are_beside_the_configuration(tmp_path):
    assert place_of_passwords(tmp_path / "room.toml") == tmp_path / "room.passwords"


def test_the_command_asks_twice_and_shows_nothing(tmp_path):
    """At a real terminal: what is typed must not be echoed."""
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "stadimeter", "web", str(tmp_path / "room.toml"), "--set-password"]
    with subprocess.Popen(command, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True) as process:
        os.close(theirs)
        shown = b""
        for asked in (b"operating: ", b"Once more: "):
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
    assert set(json.loads((tmp_path / "room.passwords").read_text())) == {"scrypt", "salt", "key", "operate"}
