"""Keys, allowed signers and a git repository, for tests of signed configurations."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Mapping
from pathlib import Path

from stadimeter.config.untrusted_file import sha256_of
from stadimeter.workbench.fleet.desired import sign
from stadimeter.workbench.fleet.reports import Desired
from support.programs import require


def make_key(folder: Path, name: str) -> Path:
    require("ssh-keygen")
    key = folder / name
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", name, "-f", str(key)], check=True)
    return key


def allow(key: Path, file: Path, options: str = "") -> Path:
    """Have a file of allowed signers name a key, by the name of its file."""
    file.write_text(f"{key.name}@example.com {options} {key.with_suffix('.pub').read_text()}")
    return file


def desired(text: str, device: str = "stadimeter/garage", **others: object) -> Desired:
    known: Mapping[str, object] = {
        "sequence": int(time.time() * 1000), "phase": "try", "cohort": "1 of 3", "commit": "1f2e3d", "reason": "why not"
    }  # fmt: skip
    return Desired(device=device, sha256=sha256_of(text), configuration=text, **{**known, **others})  # type: ignore[arg-type]


def signed(key: Path, text: str, device: str = "stadimeter/garage", **others: object) -> bytes:
    return sign([desired(text, device, **others)], key)[0]


class Repository:
    """A git repository whose commits are made of a file, and which names a key to sign with."""

    def __init__(self, folder: Path, key: Path) -> None:
        self.folder = folder
        folder.mkdir()
        for words in (
            ("init", "-q"),
            ("config", "user.name", "Ada"),
            ("config", "user.email", "ada@example.com"),
            ("config", "commit.gpgsign", "false"),
            ("config", "user.signingkey", str(key)),
        ):
            self.git(*words)

    def git(self, *words: str) -> str:
        done = subprocess.run(["git", "-C", str(self.folder), *words], check=True, capture_output=True, text=True)
        return done.stdout.strip()

    def commit(self, name: str, text: str, subject: str) -> Path:
        """Commit a file, and return where it is."""
        (self.folder / name).write_text(text)
        self.git("add", name)
        self.git("commit", "-q", "-m", subject)
        return self.folder / name
