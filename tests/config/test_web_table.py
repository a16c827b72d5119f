"""The page in a configuration: what is read, what is refused, and how it becomes a command line."""

from pathlib import Path

import pytest

from stadimeter.app.control.reloading import needs_restart
from stadimeter.app.page_process import page_command
from stadimeter.config.describe import describe
from stadimeter.config.loader import load_configuration
from stadimeter.errors import ConfigError
from support.simulated_run import SIMULATED_BALL


def load(folder, web=""):
    path = folder / "room.toml"
    path.write_text(f"{SIMULATED_BALL}\n[world]\n{web}")
    return load_configuration(path)


def test_without_a_table_there_is_no_page_and_an_empty_one_has_all_defaults(tmp_path):
    assert load(tmp_path).web is None
    found = load(tmp_path, "[web]\n")
    assert (found.web.port, found.web.host, found.web.allowed_hosts) == (8080, None, [])
    assert "Has a page for browsers at port 8080, on this computer only until a password is set" in describe(found)[1]


def test_files_lie_beside_the_configuration_and_all_becomes_a_command_line(tmp_path):
    table = """
[web]
port = 8443
host = "192.0.2.1"
certificate = "page.crt"
key = "page.key"
password_file = "secrets/page"
allowed_hosts = ["a.example", "b.example"]
"""
    command = page_command(tmp_path / "room.toml", Path("/run/s.sock"), load(tmp_path, table).web)
    assert command[3:] == [
        *("web", str(tmp_path / "room.toml"), "--socket", "/run/s.sock", "--port", "8443", "--address", "192.0.2.1"),
        *("--certificate", str(tmp_path / "page.crt"), "--key", str(tmp_path / "page.key")),
        *("--password-file", str(tmp_path / "secrets/page")),
        *("--allow-host", "a.example", "--allow-host", "b.example"),
    ]


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ("port = 0", "web.port"),
        ("port = 65536", "web.port"),
        ('port = "8080"', "web.port"),
        ('certificate = "page.crt"', "certificate and key belong together"),
        ('password = "secret"', "the configuration holds no password"),
        ("prot = 8080", "port"),
    ],
)
def test_what_is_wrong_is_said_with_its_line(tmp_path, table, words):
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, f"[web]\n{table}\n")
    assert words in str(caught.value)
    assert caught.value.problems[0].line > 20
    assert "secret" not in str(caught.value)


def test_another_page_needs_a_restart(tmp_path):
    running = load(tmp_path, "[web]\n")
    assert needs_restart(running, load(tmp_path, "[web]\nport = 8081\n")) == ("[web]",)
    assert needs_restart(running, load(tmp_path, "[web]\n")) == ()
