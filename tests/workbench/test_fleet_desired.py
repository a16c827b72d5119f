"""Signatures of desired configurations, with the real ssh-keygen."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import msgspec
import pytest

from stadimeter.errors import ConfigError
from stadimeter.workbench.fleet.desired import DESIRED_MAX_BYTES, clock_trouble, sign, verify
from support.signing import allow, desired, make_key, signed

RULES = '[rules.near]\nwhen = { below = "1 m" }  # näher\n'


@pytest.fixture(scope="module")
def ada(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_key(tmp_path_factory.mktemp("ada"), "ada")


@pytest.fixture(scope="module")
def eve(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_key(tmp_path_factory.mktemp("eve"), "eve")


@pytest.fixture
def signers(ada: Path, tmp_path: Path) -> Path:
    return allow(ada, tmp_path / "allowed_signers")


def refusal(message: bytes, signers: Path) -> str:
    with pytest.raises(ConfigError) as error:
        verify(message, signers)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_what_was_signed_is_read_with_its_signer(ada: Path, signers: Path) -> None:
    wanted = [desired(RULES, phase=phase) for phase in ("try", "apply")]
    assert [verify(each, signers) for each in sign(wanted, ada)] == [(each, "ada@example.com") for each in wanted]


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda message: message.replace(b"1 m", b"9 m"), "incorrect signature"),
        (lambda message: message.partition(b"\n")[0], "Couldn't parse signature"),
        (lambda message: message[:-60], "Couldn't parse signature"),
        (lambda _: b"", "Couldn't parse signature"),
        (lambda _: b"[" * 50_000, "Couldn't parse signature"),
        (lambda message: message + b" " * DESIRED_MAX_BYTES, "and 65536 are the most"),
    ],
)
def test_what_does_not_fit_its_signature_is_refused_in_a_sentence(
    ada: Path, signers: Path, damage: object, words: str
) -> None:
    assert callable(damage)
    assert words in refusal(damage(signed(ada, RULES)), signers)


def test_who_is_not_allowed_is_refused(ada: Path, eve: Path, signers: Path, tmp_path: Path) -> None:
    assert refusal(signed(eve, RULES), signers) == (
        f"its signature is none of those whom {signers} allows (No principal matched.)"
    )
    for_git = allow(ada, tmp_path / "for-git", 'namespaces="git"')
    assert "not permitted for use in signature namespace" in refusal(signed(ada, RULES), for_git)
    nowhere = tmp_path / "nowhere"
    assert refusal(signed(ada, RULES), nowhere) == f"there is no {nowhere}, so no signature is believed"
    (tmp_path / "nonsense").write_bytes(b"\xff\0nonsense")
    assert "none of those" in refusal(signed(ada, RULES), tmp_path / "nonsense")


def test_a_key_whose_time_has_not_come_is_refused_and_a_clock_that_was_never_set_is_said(
    ada: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    later = allow(ada, tmp_path / "later", 'valid-after="20990101"')
    assert "key is not yet valid" in refusal(signed(ada, RULES), later)
    never_set = clock_trouble(datetime(1970, 1, 1, tzinfo=UTC))
    assert never_set == "the clock here says 1970-01-01, so it was never set"
    assert clock_trouble(datetime(2026, 6, 1, tzinfo=UTC)) == ""
    monkeypatch.setattr("stadimeter.workbench.fleet.desired.clock_trouble", lambda: never_set)
    assert refusal(signed(ada, RULES), later).endswith(f"; {never_set})")


def test_what_is_signed_and_makes_no_sense_is_refused(ada: Path, signers: Path, tmp_path: Path) -> None:
    lied = sign([msgspec.structs.replace(desired(RULES), sha256="0" * 64)], ada)[0]
    assert "has another SHA-256 than it says" in refusal(lied, signers)


@pytest.mark.parametrize("line", [b"[" * 20_000, b"{}", b'{"v":2}', b"\xff\xfe", b"null"])
def test_a_signed_line_that_is_no_desired_configuration_is_refused(
    ada: Path, signers: Path, line: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("msgspec.json.encode", lambda _: line)
    message = sign([desired(RULES)], ada)[0]
    monkeypatch.undo()
    assert refusal(message, signers).startswith("it is signed by ada@example.com, and no desired configuration: ")


def test_one_that_is_too_long_or_cannot_be_signed_is_not_sent(ada: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="and 65536 are the most"):
        signed(ada, "# " + "x" * DESIRED_MAX_BYTES)
    with pytest.raises(ConfigError, match="cannot be signed with"):
        signed(tmp_path / "no-key", RULES)


def test_without_ssh_keygen_the_remedy_is_said(
    ada: Path, signers: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    message = signed(ada, RULES)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert refusal(message, signers) == (
        "ssh-keygen is not installed, which signatures need: `sudo apt install openssh-client`"
    )
