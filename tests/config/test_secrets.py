"""Secrets in a configuration are never recorded."""

from __future__ import annotations

from pathlib import Path

import pytest

from stadimeter.config.loader import Configuration, load_configuration
from stadimeter.config.secrets import shown_address
from stadimeter.errors import ConfigError
from stadimeter.testing.simulated_run import SIMULATED_BALL

SECRET = "tgram://123456789:AbCdEf/42"


def load(tmp_path: Path, notifiers: str) -> Configuration:
    path = tmp_path / "run.toml"
    path.write_text(
        f'{SIMULATED_BALL}\n[world]\n{notifiers}\n[rules.far]\nactuator = "motor"\nwhen = {{ lost = true }}\n'
    )
    return load_configuration(path)


@pytest.mark.parametrize(
    "notifiers",
    [
        f'[notifiers.phone]\ndriver = "apprise"\nurl = "{SECRET}"',
        f"[notifiers.phone]\ndriver = 'apprise'\nurl='{SECRET}'  # mine",
        f'[notifiers]\nphone = {{ url = "{SECRET}", driver = "apprise" }}',
        f'[notifiers]\nphone.driver = "apprise"\nphone.url = "{SECRET}"',
        f'[notifiers]\na = {{ driver = "apprise", url = "{SECRET}" }}\nb = {{ driver = "apprise", url = "{SECRET}" }}',
    ],
)
def test_a_url_is_taken_out_of_what_is_recorded_and_warned_of(tmp_path: Path, notifiers: str) -> None:
    configuration = load(tmp_path, notifiers)
    assert SECRET not in configuration.text
    assert SECRET not in repr(configuration)
    assert "hidden://" in configuration.text
    hints = {warning.hint for warning in configuration.warnings if warning.code == "secret"}
    assert hints == {'put it into a file of its own and write url_file = "…"'}
    assert configuration.notifiers[0].options.url.get_secret_value() == SECRET


def test_a_recorded_configuration_can_be_loaded_again_without_a_warning(tmp_path: Path) -> None:
    recorded = load(tmp_path, f'[notifiers.phone]\ndriver = "apprise"\nurl = "{SECRET}"').text
    path = tmp_path / "recorded.toml"
    path.write_text(recorded)
    again = load_configuration(path)
    assert again.text == recorded
    assert "secret" not in {warning.code for warning in again.warnings}


def test_a_configuration_without_secrets_is_recorded_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "phone.txt").write_text(SECRET)
    configuration = load(tmp_path, '[notifiers.phone]\ndriver = "apprise"\nurl_file = "phone.txt"')
    assert configuration.text == configuration.path.read_text()
    assert "secret" not in {warning.code for warning in configuration.warnings}


@pytest.mark.parametrize("written", [f'"""\n{SECRET}"""', f"'''{SECRET}\\\n'''"])
def test_a_url_that_cannot_be_taken_out_is_refused_without_repeating_it(tmp_path: Path, written: str) -> None:
    with pytest.raises(ConfigError) as raised:
        load(tmp_path, f'[notifiers.phone]\ndriver = "apprise"\nurl = {written}')
    assert "write it as text in simple quotes on the line of its key" in str(raised.value)
    assert "AbCdEf" not in str(raised.value)


@pytest.mark.parametrize("written", ['"AbCdEf"', "5", '["tgram://AbCdEf"]', '{ a = "tgram://AbCdEf" }'])
def test_a_wrong_url_is_refused_without_repeating_it(tmp_path: Path, written: str) -> None:
    with pytest.raises(ConfigError) as raised:
        load(tmp_path, f'[notifiers.phone]\ndriver = "apprise"\nurl = {written}')
    assert "AbCdEf" not in str(raised.value)


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("rtsp://10.0.0.9:554/live", "rtsp://10.0.0.9:554/live"),
        ("rtsp://me:secret@10.0.0.9/live", "rtsp://10.0.0.9/live"),
        ("http://cam.local/?action=stream&token=secret", "http://cam.local/?…"),
        ("http://me:se@cret@cam.local/stream#secret", "http://cam.local/stream?…"),
        ("http://[fe80::1]:8080/stream", "http://[fe80::1]:8080/stream"),
        ("rtsp://me:se/cret@cam.local/live", "rtsp://…"),
        ("rtsp://me:se#cret@cam.local/live", "rtsp://…"),
        ("rtsp://me:se?cret@cam.local/live", "rtsp://…"),
        ("http://[me:secret", "http://[me:secret"),
        ("me:secret@10.0.0.9/live", "10.0.0.9/live"),
        ("/dev/v4l/by-id/usb-cam-video-index0", "/dev/v4l/by-id/usb-cam-video-index0"),
    ],
)
def test_an_address_is_shown_without_what_may_be_secret_in_it(address: str, shown: str) -> None:
    assert shown_address(address) == shown
