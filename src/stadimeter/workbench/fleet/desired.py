"""Signing desired configurations: one line of JSON for one device, and the OpenSSH signature of that line.

::

    {"v":1,"device":"stadimeter/hall/press","sequence":1764130000000,"phase":"try","configuration":"[rules.near]…",…}
    -----BEGIN SSH SIGNATURE-----
    …

OpenSSH is on every Raspberry Pi OS, and its keys are those that people sign commits with. The signature is over the
bytes of the line, with a namespace of its own, so that the signature of a commit is none of a configuration. The line
names its device and a sequence number, so neither a message for another device nor an older one can be used again. No
clock is believed for that.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Collection
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec

from stadimeter.config.untrusted_file import sha256_of
from stadimeter.core.words import one_line
from stadimeter.errors import ConfigError
from stadimeter.workbench.fleet.reports import Desired

NAMESPACE = "stadimeter-configuration"

# The whole message, with its signature.
DESIRED_MAX_BYTES = 64 * 1024

# A clock before this was never set: a Pi without a clock chip begins in 1970, or where it was switched off.
FIRST_YEAR = 2024

# To check takes some milliseconds; to sign may wait for a person who types a passphrase.
_CHECK_S, _SIGN_S = 30.0, 300.0


def sign(wanted: Collection[Desired], key: Path) -> list[bytes]:
    """Return a message for each, all signed by one call, so that a passphrase is asked for once.

    Args:
        key: A private key, or a public one whose private key an agent holds.

    Raises:
        ConfigError: They cannot be signed, or one is too long to be sent.
    """
    messages = [msgspec.json.encode(each) + b"\n" for each in wanted]
    with TemporaryDirectory(prefix="stadimeter-") as folder:
        files = [Path(folder, str(number)) for number in range(len(messages))]
        for file, message in zip(files, messages, strict=True):
            file.write_bytes(message[:-1])
        done = _ssh_keygen("sign", "-f", key, "-n", NAMESPACE, *files, wait_s=_SIGN_S)
        if done.returncode:
            raise ConfigError(f"it cannot be signed with {key}: {_in_words(done.stderr)}")
        for number, file in enumerate(files):
            messages[number] += file.with_name(f"{file.name}.sig").read_bytes()
            _check_length(messages[number])
    return messages


def verify(message: bytes, allowed_signers: Path) -> tuple[Desired, str]:
    """Return what a message wants, and who signed it. Nothing of it is read before its signature is found right.

    Raises:
        ConfigError: It is not signed by one of the allowed signers, or is damaged; a sentence says why.
    """
    _check_length(message)
    line, _, signature = message.partition(b"\n")
    signer = _signer_of(line, signature, allowed_signers)
    try:
        desired = msgspec.json.decode(line, type=Desired)
    except (ValueError, RecursionError) as error:  # msgspec's errors are ValueErrors
        raise ConfigError(f"it is signed by {signer}, and no desired configuration: {error}") from error
    if sha256_of(desired.configuration) != desired.sha256:
        raise ConfigError(f"it is signed by {signer}, and its configuration has another SHA-256 than it says")
    return desired, signer


def clock_trouble(now: datetime | None = None) -> str:
    """Say that this computer's clock was never set; empty if it may be right."""
    now = now or datetime.now(UTC)
    return f"the clock here says {now:%Y-%m-%d}, so it was never set" if now.year < FIRST_YEAR else ""


def _check_length(message: bytes) -> None:
    if len(message) > DESIRED_MAX_BYTES:
        raise ConfigError(f"with its signature it has {len(message)} bytes, and {DESIRED_MAX_BYTES} are the most")


def _signer_of(line: bytes, signature: bytes, allowed_signers: Path) -> str:
    """Return who signed, by the name that stands in the file of the allowed signers."""
    if not allowed_signers.is_file():
        raise ConfigError(f"there is no {allowed_signers}, so no signature is believed")
    with TemporaryDirectory(prefix="stadimeter-") as folder:
        file = Path(folder, "signature")
        file.write_bytes(signature)
        signed = ("-s", file, "-f", allowed_signers)
        done = _ssh_keygen("find-principals", *signed)
        signer = done.stdout.decode(errors="replace").partition("\n")[0].split(",")[0]
        if not done.returncode:
            done = _ssh_keygen("verify", *signed, "-I", signer, "-n", NAMESPACE, data=line)
    if done.returncode:
        why = "; ".join(filter(None, (_in_words(done.stderr), clock_trouble())))
        raise ConfigError(f"its signature is none of those whom {allowed_signers} allows ({why})")
    return one_line(signer)


def _ssh_keygen(
    operation: str, *words: str | Path, data: bytes = b"", wait_s: float = _CHECK_S
) -> subprocess.CompletedProcess[bytes]:
    command, environment = ["ssh-keygen", "-Y", operation, *map(str, words)], {**os.environ, "LC_ALL": "C"}
    try:
        return subprocess.run(  # noqa: S603 - no shell; of a message only the contents of files
            command, input=data, capture_output=True, timeout=wait_s, env=environment, check=False
        )
    except FileNotFoundError as error:
        remedy = "`sudo apt install openssh-client`"
        raise ConfigError(f"ssh-keygen is not installed, which signatures need: {remedy}") from error
    except subprocess.TimeoutExpired as error:
        raise ConfigError(f"ssh-keygen did not end within {wait_s:g} s") from error


def _in_words(output: bytes) -> str:
    words = "; ".join(output.decode(errors="replace").splitlines())
    return one_line(words[:300]) or "ssh-keygen does not say why"
