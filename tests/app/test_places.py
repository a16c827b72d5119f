"""Where instances listen, and where they remember."""

import os
import socket
from pathlib import Path

import pytest

from stadimeter.app.control.client import ask, find
from stadimeter.app.control.places import is_alive, running, runtime_folder, socket_path, usable_folder
from stadimeter.app.control.socket_server import ControlSocket
from stadimeter.app.keeping.state_places import state_file
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


def test_without_any_such_folder_there_are_places_all_the_same(monkeypatch):
    monkeypatch.setenv("HOME", "/home/ada")
    assert runtime_folder({}).name == f"stadimeter-{os.getuid()}"
    assert state_file(CONFIG, {}) == Path("/home/ada/.local/state/stadimeter/appliance.sqlite3")


def test_a_folder_for_sockets_is_ours_alone(tmp_path):
    folder = usable_folder(tmp_path / "new")
    assert folder.stat().st_mode & 0o777 == 0o700
    assert usable_folder(folder) == folder


def test_a_folder_that_others_may_write_into_is_refused(tmp_path):
    tmp_path.chmod(0o777)
    with pytest.raises(ControlError, match="others may write there"):
        usable_folder(tmp_path)


def test_a_link_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with pytest.raises(ControlError, match="cannot be used for a socket"):
        usable_folder(tmp_path / "link")


def test_a_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ControlError, match="cannot be used for a socket"):
        usable_folder(tmp_path / "file")


def test_a_path_that_the_kernel_does_not_take_is_refused(tmp_path):
    with pytest.raises(ControlError, match="too long for a socket: 107 bytes at most"):
        socket_path(Path("a" * 120 + ".toml"), tmp_path)


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


def test_instances_that_listen_are_found_and_what_is_left_of_others_is_not(instance, tmp_path):
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(instance.with_name("left.sock")))
    assert running({"XDG_RUNTIME_DIR": str(tmp_path)}, tmp_path / "none") == [instance]
    assert running({"XDG_RUNTIME_DIR": str(tmp_path / "other")}, instance.parent) == [instance]
    assert not is_alive(instance.with_name("left.sock"))


def test_a_second_instance_of_one_configuration_listens_elsewhere(instance):
    assert socket_path(CONFIG, instance.parent).name == f"appliance-{os.getpid()}.sock"


def test_an_instance_is_found_by_its_configuration(instance):
    assert find(CONFIG, [instance]) == instance
    assert find(None, [instance]) == instance
    with pytest.raises(ControlError, match="no instance runs with"):
        find(Path("/etc/other.toml"), [instance])


def test_an_instance_that_does_not_answer_is_said_to_hang(instance):
    with pytest.raises(ControlError, match=r"no answer within 0\.1 s; does it hang\?"):
        ask(instance, "status", wait_s=0.1)


def test_where_nobody_listens_that_is_said(tmp_path):
    with pytest.raises(ControlError, match="nobody listens there"):
        ask(tmp_path / "none.sock", "status")
