"""Files are written whole or not at all."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import stadimeter
from stadimeter.config.atomic_file import write_atomically

WRITE = """
import resource, signal, sys
from pathlib import Path
from stadimeter.config.atomic_file import write_atomically
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    write_atomically(Path(sys.argv[1]), b"x" * 100_000)
except OSError as error:
    sys.exit(error.errno)
"""


def test_a_file_is_written(tmp_path: Path) -> None:
    write_atomically(tmp_path / "a", b"new")
    assert (tmp_path / "a").read_bytes() == b"new"


def test_a_file_is_replaced_and_keeps_no_rubbish_beside_it(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"old and longer")
    write_atomically(tmp_path / "a", b"new")
    assert (tmp_path / "a").read_bytes() == b"new"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_disk_that_fills_up_leaves_the_old_file_as_it_was(tmp_path: Path) -> None:
    """A limit on the size of files stands in for a full disk: the write fails in the middle."""
    (tmp_path / "a").write_bytes(b"old")
    run = subprocess.run([sys.executable, "-c", WRITE, str(tmp_path / "a")], check=False)
    assert run.returncode == 27, "EFBIG"
    assert (tmp_path / "a").read_bytes() == b"old"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_folder_in_the_way_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    with pytest.raises(OSError, match="directory"):
        write_atomically(tmp_path / "a", b"new")
    assert [each.name for each in tmp_path.iterdir()] == ["a"]


def test_what_a_cut_left_behind_is_used_up_by_the_next_save(tmp_path: Path) -> None:
    (tmp_path / ".a.part").write_bytes(b"half of something that was longer than what comes now")
    write_atomically(tmp_path / "a", b"new")
    assert (tmp_path / "a").read_bytes() == b"new"
    assert [each.name for each in tmp_path.iterdir()] == ["a"]


def test_savers_at_the_same_time_wait_for_each_other(tmp_path: Path) -> None:
    texts = [bytes([number]) * 50_000 for number in range(8)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda text: write_atomically(tmp_path / "a", text), texts))
    assert (tmp_path / "a").read_bytes() in texts
    assert [each.name for each in tmp_path.iterdir()] == ["a"]


def test_a_file_that_is_replaced_keeps_its_mode_and_its_group(tmp_path: Path) -> None:
    """The service reads a camera file in /etc by its group, also after root has measured anew."""
    file = tmp_path / "a"
    file.write_bytes(b"old")
    file.chmod(0o640)
    if os.geteuid() == 0:
        os.chown(file, 1, 2)
    owner = file.stat().st_uid, file.stat().st_gid
    write_atomically(file, b"new")
    assert (file.stat().st_uid, file.stat().st_gid) == owner
    assert file.stat().st_mode & 0o777 == 0o640


def test_a_link_stays_a_link_and_the_file_that_it_leads_to_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "writable").mkdir()
    (tmp_path / "a").symlink_to("writable/a")
    for text in (b"first", b"second"):
        write_atomically(tmp_path / "a", text)
        assert (tmp_path / "a").is_symlink()
        assert (tmp_path / "writable" / "a").read_bytes() == text
    assert sorted(each.name for each in tmp_path.iterdir()) == ["a", "writable"]


WRITES_FILES = {"write_text", "write_bytes", "imwrite", "savefig", "tofile", "savez", "mkstemp", "NamedTemporaryFile"}
SAVES = {
    "workbench/tuning/plot.py": "into memory",
    "app/service.py": "a counter of failed starts, which counts from 0 where it cannot be read",
    "workbench/bench.py": "into a temporary folder",
    "web/passwords.py": "a hidden file first, as there; the page imports nothing of `config`",
}


def test_every_file_is_saved_in_one_place() -> None:
    """A call that writes a file in another way would leave half of it after a cut."""
    package = Path(stadimeter.__file__).parent
    found = {
        str(file.relative_to(package)): node.func.attr
        for file in package.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text("utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
        if node.func.attr in WRITES_FILES or (node.func.attr == "open" and _opens_for_writing(node))
    }
    assert set(found) <= {*SAVES}, found


def _opens_for_writing(call: ast.Call) -> bool:
    modes = [*call.args, *(keyword.value for keyword in call.keywords if keyword.arg == "mode")]
    return any(isinstance(mode, ast.Constant) and set(str(mode.value)) & set("wax+") for mode in modes)
