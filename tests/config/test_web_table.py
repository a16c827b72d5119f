"""The page in a configuration: what is read, what is refused, and how `stadimeter web` goes by it."""

import json

import pytest
from typer.testing import CliRunner

from stadimeter.cli.main import app
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
    assert "Its page for browsers is at port 8080." in describe(found)[1]


TABLE = """
[web]
port = 8443
host = "192.0.2.1"
certificate = "page.crt"
key = "page.key"
password_file = "secrets/page"
allowed_hosts = ["a.example", "b.example"]
others = ["http://garage.local:8080/", "https://[2001:db8::7]"]
others_tokens = "secrets/tokens"
"""


@pytest.fixture
def given(tmp_path, monkeypatch):
    """Return what the page is started with, for a table and more words of the command line."""
    pytest.importorskip("uvicorn")

    def given(text, *words):
        path = tmp_path / "room.toml"
        path.write_text(text)
        commands = []
        monkeypatch.setattr("os.execv", lambda _program, command: commands.append(command))
        result = CliRunner().invoke(app, ["web", str(path), *words])
        return json.loads(commands[0][-1]) if commands else result.output

    return given


def test_the_page_is_where_the_table_says_with_files_beside_the_configuration(given, tmp_path):
    assert given(TABLE) == {
        "paths": {
            "configuration": str(tmp_path / "room.toml"),
            "passwords": str(tmp_path / "secrets/page"),
            "socket": None,
            "certificate": str(tmp_path / "page.crt"),
            "key": str(tmp_path / "page.key"),
            "others_tokens": str(tmp_path / "secrets/tokens"),
        },
        "address": "192.0.2.1",
        "port": 8443,
        "allowed_hosts": ["a.example", "b.example"],
        "others": ["http://garage.local:8080", "https://[2001:db8::7]"],
    }


@pytest.mark.parametrize(
    "wrong",
    ["garage.local", "ftp://garage", "http://", "http://a/b", "http://me:secret@a", "http://a:8080?x=1", "http://a b"],
)
def test_what_is_no_address_of_a_page_is_refused_without_its_secrets(given, wrong):
    told = given(f'[web]\nothers = ["{wrong}"]\n')
    assert "is not the address of a page, such as 'http://garage.local:8080'" in told
    assert "room.toml:2" in told
    assert "secret" not in told


def test_an_option_goes_before_the_table(given, tmp_path):
    there = given(TABLE, "--port", "0", "--address", "127.0.0.1", "--password-file", "p")
    assert (there["port"], there["address"]) == (0, "127.0.0.1")
    assert there["paths"]["passwords"] == "p"
    assert there["paths"]["key"] == str(tmp_path / "page.key")


def test_the_page_is_also_for_a_file_with_errors_but_not_where_its_own_table_cannot_be_read(given):
    assert given(f'{TABLE}\n[camera]\ndriver = "nonsense"\n')["port"] == 8443
    assert given("# the web\n[broken")["port"] == 8080
    assert "room.toml:3: web.prot: unknown key 'prot' (did you mean 'port'?)" in given("\n[web]\nprot = 8081\n")
    assert "room.toml:1: web: 3 is not a table" in given("web = 3\n")
    assert "room.toml:2: this is not valid TOML" in given("[web]\n[broken")


def test_a_password_is_set_in_the_file_of_the_table(tmp_path):
    pytest.importorskip("uvicorn")
    path = tmp_path / "room.toml"
    path.write_text('[web]\npassword_file = "secret"\n')
    told = CliRunner().invoke(app, ["web", str(path), "--set-password"], input="long enough\nlong enough\n")
    assert f"Its hash is in {tmp_path / 'secret'}." in told.output.replace("\n", " ")
    assert (tmp_path / "secret").exists()


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
