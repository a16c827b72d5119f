"""Where instances listen, and where they remember."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from stadimeter.app import places
from stadimeter.app.control import client
from stadimeter.app.control.client import ask, find
from stadimeter.app.control.socket_server import ControlSocket
from stadimeter.app.places import is_alive, make_folder, running, runtime_folder, socket_path, state_file
from stadimeter.errors import ControlError

CONFIG = Path("/etc/stadimeter/appliance.toml")


def test_a_service_listens_and_remembers_where_systemd_says():
    environ = {"RUNTIME_DIRECTORY": "/run/stadimeter", "STATE_DIRECTORY": "/var/lib/stadimeter:/var/lib/other"}
    assert runtime_folder(environ) == Path("/run/stadimeter")
    assert state_file(CONFIG, environ) == Path("/var/lib/stadimeter/appliance.sqlite3")


def test_a_user_listens_and_remembers_in_folders_of_their_own():
    environ = {"XDG_RUNTIME_DIR": "/run/user/1000", "XDG_STATE_HOME": "/home/ada/state"}
    assert runtime_folder(environ) == Path("/run/user/1000/stadimeter")
    assert state_file(CONFIG, environ) == Path("/home/ada/state/stadimeter/appliance.sqlite3")


def test_root_listens_where_only_root_can_make_a_folder(monkeypatch, tmp_path):
    """Among the temporary files, or in the folder of whoever called sudo, another user could be there first."""
    theirs = tmp_path.stat().st_uid + 1
    monkeypatch.setattr(os, "getuid", lambda: 0)
    assert runtime_folder({}) == Path("/run/stadimeter-root")
    monkeypatch.setattr(os, "getuid", lambda: theirs)
    assert runtime_folder({"XDG_RUNTIME_DIR": str(tmp_path)}).parent != tmp_path


def test_a_folder_for_sockets_is_ours_alone(tmp_path):
    folder = make_folder(tmp_path / "new")
    assert folder.stat().st_mode & 0o777 == 0o700
    assert make_folder(folder) == folder


def test_a_folder_that_others_may_write_into_is_refused(tmp_path):
    tmp_path.chmod(0o777)
    with pytest.raises(ControlError, match="others may write there"):
        make_folder(tmp_path)


def test_a_link_or_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    (tmp_path / "file").touch()
    for name in ("link", "file"):
        with pytest.raises(ControlError, match="cannot be used for a socket"):
            make_folder(tmp_path / name)


@pytest.fixture
def instance(tmp_path):
    """Return the folder of an instance that listens, and answers nothing but who it is."""
    folder = tmp_path / "stadimeter"
    folder.mkdir()
    path = socket_path(CONFIG, folder)
    listening = ControlSocket(path, lambda: {"configuration": str(CONFIG), "pid": 7})
    listening.open()
    yield path
    listening.close()


def test_instances_that_listen_are_found_and_what_is_left_of_others_is_not(instance, tmp_path, monkeypatch):
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(instance.with_name("left.sock")))
    monkeypatch.setattr(places, "SERVICE_FOLDER", tmp_path / "none")
    assert running({"XDG_RUNTIME_DIR": str(tmp_path)}) == [instance]
    monkeypatch.setattr(places, "SERVICE_FOLDER", instance.parent)
    assert running({"XDG_RUNTIME_DIR": str(tmp_path / "other")}) == [instance]
    assert not is_alive(instance.with_name("left.sock"))


def test_that_none_runs_is_not_said_while_one_that_may_be_it_does_not_answer(instance, tmp_path, monkeypatch):
    def ask_patiently(path, op, wait_s):
        """Ask, and wait for one that answers for as long as a busy machine takes."""
        return ask(path, op, wait_s=0.1 if path.name == "hanging.sock" else 60.0)

    monkeypatch.setattr(client, "ask", ask_patiently)
    with socket.socket(socket.AF_UNIX) as hanging:
        hanging.bind(str(tmp_path / "hanging.sock"))
        hanging.listen()
        with pytest.raises(ControlError, match="one that runs does not answer") as refused:
            find(Path("/etc/other.toml"), [tmp_path / "hanging.sock", instance], names_others=False)
        assert find(CONFIG, [tmp_path / "hanging.sock", instance]) == instance
    assert "no instance runs" not in str(refused.value)


def test_an_instance_that_does_not_answer_is_said_to_hang(instance):
    with pytest.raises(ControlError, match=r"no answer within 0\.1 s; does it hang\?"):
        ask(instance, "status", wait_s=0.1)


LISTEN = """
import os, socket, sys
listener = socket.socket(socket.AF_UNIX)
listener.bind(sys.argv[1])
if os.getuid() == 0:
    os.setuid(int(sys.argv[2]))
listener.listen()
print("listening", flush=True)
connection, _ = listener.accept()
print(len(connection.recv(1000)), flush=True)
"""


@pytest.fixture
def theirs(tmp_path, monkeypatch):
    """Return a user who is not us. Without the rights of root, we are the ones who pretend to be somebody else."""
    real = os.getuid()
    if real != 0:
        monkeypatch.setattr(os, "getuid", lambda: real + 1)
    return real or 65534


@pytest.fixture
def folder_is_ours(monkeypatch):
    """Have the folder believed: without the rights of root it is that of the user who pretends to be another."""
    if os.geteuid() != 0:
        monkeypatch.setattr(places, "check_folder", lambda folder: folder)


def give_to(user, path):
    if os.geteuid() == 0:
        os.chown(path, user, -1)


@pytest.mark.usefixtures("folder_is_ours")
def test_another_user_who_listens_in_our_place_is_told_nothing(tmp_path, theirs):
    path = tmp_path / "door.sock"
    with subprocess.Popen(
        [sys.executable, "-c", LISTEN, str(path), str(theirs)], stdout=subprocess.PIPE, text=True
    ) as impostor:
        assert impostor.stdout.readline() == "listening\n"
        with pytest.raises(ControlError, match=r"sock: not asked: it belongs to another user \(\d+\)"):
            ask(path, "ack", {"rule": "near"})
        if os.geteuid() == 0:
            assert impostor.stdout.readline() == "0\n"
        impostor.kill()


@pytest.mark.usefixtures("folder_is_ours")
def test_a_socket_of_another_user_is_not_asked(instance, theirs):
    give_to(theirs, instance)
    with pytest.raises(ControlError, match=r"sock: not asked: it belongs to another user \(\d+\)"):
        ask(instance, "status")


def test_a_link_to_a_socket_is_not_asked(instance):
    """Another user could lead root to a socket of root that belongs to another program."""
    link = instance.with_name("link.sock")
    link.symlink_to(instance)
    with pytest.raises(ControlError, match="it is no socket"):
        ask(link, "status")


def test_a_folder_of_another_user_is_left_out_by_both_sides_and_said_so(instance, theirs, monkeypatch):
    folder = instance.parent
    monkeypatch.setattr(places, "runtime_folder", lambda _environ: folder)
    monkeypatch.setattr(places, "SERVICE_FOLDER", folder / "none")
    give_to(theirs, folder)
    assert running() == []
    with pytest.raises(ControlError, match=rf"no instance of stadimeter is running.*; {folder} .*to another user"):
        find()
    with pytest.raises(ControlError, match="belongs to another user"):
        make_folder(folder)
    with pytest.raises(ControlError, match="belongs to another user"):
        ControlSocket(folder / "door.sock", dict).open()


def test_the_user_of_the_service_is_believed_in_the_folder_of_the_service_only(instance, theirs, monkeypatch):
    give_to(theirs, instance.parent)
    give_to(theirs, instance)
    with pytest.raises(ControlError, match="belongs to another user"):
        ask(instance, "hello")
    monkeypatch.setattr(places, "SERVICE_FOLDER", instance.parent)
    assert ask(instance, "hello")["pid"] == 7
