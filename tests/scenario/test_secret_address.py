"""A camera with a password in its address, a run with all that it leaves behind, and a search for the password."""

from __future__ import annotations

import base64
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from stadimeter.cli.main import app
from stadimeter.testing.rig import eventually
from stadimeter.workbench.replay import read_recording
from support.broker import MosquittoBroker
from support.mqtt_listener import MqttListener
from support.recordings import records_of
from support.simulated_run import LENS

PASSWORD, TOKEN = "hunter2", "tok3n"
LOGIN = base64.b64encode(f"admin:{PASSWORD}".encode())
SECRETS = (PASSWORD.encode(), TOKEN.encode(), LOGIN, base64.b64encode(f":{PASSWORD}".encode()))

CONFIG = """
[camera]
driver = "opencv"
{device}
{lens}
[targets.sheet]
detector = "sheet"
width = "10 cm"
height = "20 cm"

[actuators.motor]
driver = "simulated"

[messenger]
driver = "mqtt"
port = {port}

[rules.gone]
severity = "safety"  # it does not wait for a target that was never seen
actuator = "motor"
when = {{ lost = true }}

[[rules.gone.escalation]]
topic = "gone"
text = "see {link} now"
"""


class Stream(BaseHTTPRequestHandler):
    """Sends pictures to whoever has the password, until the server is told to refuse everybody."""

    def do_GET(self) -> None:
        asked = self.headers.get("Authorization", "") == f"Basic {LOGIN.decode()}" and TOKEN in self.path
        if self.server.refuses or not asked:
            self.send_response(401)
            self.send_header("WWW-Authenticate", 'Basic realm="camera"')
            self.end_headers()
            return
        self.server.served += 1
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        random = np.random.default_rng(1)
        while not self.server.refuses:
            picture = random.integers(56, 64, (480, 640, 3), np.uint8)  # noise, or it would count as frozen
            jpeg = cv2.imencode(".jpg", picture)[1].tobytes()
            try:
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                self.wfile.write(head.encode() + jpeg + b"\r\n")
            except OSError:
                return
            time.sleep(0.03)

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture
def server() -> Iterator[ThreadingHTTPServer]:
    with ThreadingHTTPServer(("127.0.0.1", 0), Stream) as server:
        server.refuses, server.served = False, 0
        threading.Thread(target=server.serve_forever, name="camera server").start()
        yield server
        server.refuses = True
        server.shutdown()


@pytest.mark.long
@pytest.mark.timeout(120)
@pytest.mark.parametrize("key", ["device", "device_file"])
def test_the_password_of_a_camera_is_in_nothing_that_a_run_says_writes_or_sends(
    server: ThreadingHTTPServer, tmp_path: Path, key: str
) -> None:
    address = f"http://admin:{PASSWORD}@127.0.0.1:{server.server_port}/live?token={TOKEN}"
    secret = tmp_path / "secret"
    secret.mkdir()
    (secret / "camera.txt").write_text(address + "\n")
    device = f'device = "{address}"' if key == "device" else 'device_file = "camera.txt"'
    broker = MosquittoBroker(tmp_path)
    config = secret / "run.toml"
    config.write_text(CONFIG.format(device=device, lens=LENS, port=broker.port, link="http://wall/?panel=3"))
    env = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path / "r"), "XDG_STATE_HOME": str(tmp_path / "s")}
    said = []

    def ask(*words: object) -> Result:
        done = CliRunner().invoke(app, [*map(str, words)], env=env)
        said.append(done.output_bytes)
        return done

    checked = ask("check", config)
    assert ("write device_file" in checked.stdout) is (key == "device")
    broker.start()
    with MqttListener(broker.port) as listener:
        files = ["--journal", tmp_path / "run.jsonl", "--record", tmp_path / "run.mcap", "--image-rate", "1"]
        command = [sys.executable, "-m", "stadimeter", "run", config, *files]
        with subprocess.Popen([*map(str, command)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=env) as run:
            try:
                journal = tmp_path / "run.jsonl"
                eventually(lambda: journal.exists() and journal.read_bytes().count(b"\n") > 20)
                assert ask("status", "--config", config).exit_code == 0
                ask("explain", "gone", "--config", config)
                assert ask("reload", "--config", config).exit_code == 0
                server.refuses = True
                eventually(lambda: b"cannot be opened" in journal.read_bytes())
                ask("status", "--config", config)
            finally:
                run.send_signal(signal.SIGTERM)
                said.extend(run.communicate(timeout=120))
        said += [f"{heard.topic} {heard.payload}".encode() for heard in listener.heard]
    broker.stop()
    assert any(b"see http://wall/?panel=3 now" in words for words in said), "what a rule sends is sent whole"
    assert ask("run", config, "--no-state", "--seconds", "1").exit_code == 2  # refused at the start
    for name in ("run.jsonl", "run.mcap"):
        assert "decisions identical" in ask("replay", tmp_path / name, "--strict", "--config", config).stdout
        assert ask("replay", tmp_path / name, "--strict").exit_code == 0
        assert list(records_of(read_recording(tmp_path / name)))

    left = [path for path in tmp_path.rglob("*") if path.is_file() and secret not in path.parents]
    assert {path.suffix for path in left} >= {".jsonl", ".mcap", ".sqlite3"}
    everything = b"\n".join([*said, *(path.read_bytes() for path in left)])
    assert not [each for each in SECRETS if each in everything]
    ours = [path for path in left if path.suffix in {".jsonl", ".mcap", ".sqlite3"}]
    assert {path.stat().st_mode & 0o777 for path in ours} == {0o600}
