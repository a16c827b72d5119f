"""Files are written whole or not at all."""

from __future__ import annotations

import ast
import os
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import stadimeter
from stadimeter.config.files import write_all_atomically, write_atomically

WRITE = """
import resource, signal, sys
from pathlib import Path
from stadimeter.config.files import write_atomically
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
try:
    write_atomically(Path(sys.argv[1]), b"x" * 100_000)
except OSError as error:
    sys.exit(error.errno)
"""


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


def make_device(path: Path) -> None:
    """Make a node of a device that swallows all, as /dev/null is one; never try it on that."""
    try:
        os.mknod(path, stat.S_IFCHR | 0o666, os.makedev(1, 3))
    except PermissionError:
        pytest.skip("only root makes devices, and not everywhere")


@pytest.mark.parametrize("make", [os.mkfifo, Path.mkdir, make_device])
@pytest.mark.parametrize("by_link", [False, True])
def test_only_a_file_is_replaced_and_anything_else_is_left_alone(
    tmp_path: Path, make: Callable[[Path], None], by_link: bool
) -> None:
    place = tmp_path / "special"
    make(place)
    before = place.stat().st_mode
    name = tmp_path / "link" if by_link else place
    if by_link:
        name.symlink_to(place)
    with pytest.raises(OSError, match=r"no regular file, and is left alone|directory"):
        write_all_atomically({tmp_path / "other": b"new", name: b"new"})
    assert place.stat().st_mode == before
    assert name.is_symlink() == by_link
    assert not (tmp_path / "other").exists()


SAVE_AT_ONCE = """
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from stadimeter.config.files import write_atomically
sys.setswitchinterval(1e-5)  # threads take turns between nearly any two steps
with ThreadPoolExecutor(8) as pool:
    list(pool.map(lambda number: write_atomically(Path(sys.argv[1]), bytes([number % 256]) * 500), range(320)))
"""


@pytest.mark.long
def test_savers_at_the_same_time_leave_one_whole_file(tmp_path: Path) -> None:
    run = subprocess.run([sys.executable, "-c", SAVE_AT_ONCE, str(tmp_path / "a")], check=False, timeout=120)
    assert run.returncode == 0
    assert len((tmp_path / "a").read_bytes()) == 500
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
    "config/files.py": "the one place",
    "app/service.py": "a counter of failed starts, which counts from 0 where it cannot be read",
    "web/passwords.py": "a hidden file first, as there; the page imports nothing of `config`",
}


@pytest.fixture(scope="module")
def method_calls() -> list[tuple[str, ast.Call]]:
    """Return every call of a method in the package, with the file that it stands in."""
    package = Path(stadimeter.__file__).parent
    return [
        (str(file.relative_to(package)), node)
        for file in package.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text("utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
    ]


@pytest.mark.long
def test_every_file_is_saved_in_one_place(method_calls: list[tuple[str, ast.Call]]) -> None:
    """A call that writes a file in another way would leave half of it after a cut."""
    found = {
        file: call.func.attr
        for file, call in method_calls
        if call.func.attr in WRITES_FILES or (call.func.attr == "open" and _opens_for_writing(call))
    }
    assert set(found) <= {*SAVES}, found


def _opens_for_writing(call: ast.Call) -> bool:
    modes = [*call.args, *(keyword.value for keyword in call.keywords if keyword.arg == "mode")]
    return any(isinstance(mode, ast.Constant) and set(str(mode.value)) & set("wax+") for mode in modes)
