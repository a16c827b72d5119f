"""What a broker keeps of a whole program says no more than is known: real broker, real processes, no state file."""

import json
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest

from stadimeter.testing.rig import eventually
from support.broker import MosquittoBroker
from support.mqtt_listener import MqttListener
from support.programs import needs
from support.simulated_run import SIMULATED_BALL

pytestmark = needs("mosquitto")

BASE = "stadimeter/it"
RULE = """
[rules.{name}]
when = {{ below = "2 m" }}
off_delay = "0 s"

[[rules.{name}.escalation]]
topic = "{name}/door"
text = "open"
retain = true
"""


class Site:
    """A broker with a subscriber, and a configuration that can be changed."""

    def __init__(self, folder, broker, listener):
        self.folder = folder
        self.broker = broker
        self.listener = listener
        self.configuration = folder / "run.toml"

    def write(self, *rules, path='{ at = "0 s", x = "1 m", y = "0 m" }', world=""):
        messenger = f'[messenger]\ndriver = "mqtt"\nport = {self.broker.port}\nnode = "it"\n'
        where = f"[world]\nloop = false\npath = [{path}]\n{world}"
        self.configuration.write_text(
            SIMULATED_BALL + messenger + where + "".join(RULE.format(name=name) for name in rules)
        )

    @contextmanager
    def running(self):
        command = [sys.executable, "-m", "stadimeter", "run", self.configuration]
        with (self.folder / "words.txt").open("wb") as words:
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=words, stderr=words)
        try:
            yield process
        finally:
            process.kill()
            process.wait()

    def heard(self, rule, what):
        return self.listener.payloads(f"{BASE}/rule/{rule}/{what}")

    def is_active(self, rule):
        payloads = self.heard(rule, "state")
        return json.loads(payloads[-1])["active"] if payloads and payloads[-1] else None


@pytest.fixture
def site(tmp_path):
    broker = MosquittoBroker(tmp_path)
    broker.start()
    try:
        with MqttListener(broker.port) as listener:
            yield Site(tmp_path, broker, listener)
    finally:
        broker.stop()


def run_until_raised(site, end):
    with site.running() as process:
        eventually(lambda: site.is_active("near"))
        eventually(lambda: site.listener.payloads(f"{BASE}/near/door"))
        eventually(lambda: any("near" in page for page in site.listener.payloads(f"{BASE}/retained/it/0")))
        process.send_signal(end)
        process.wait()


@pytest.mark.long
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM])
def test_a_rule_that_is_renamed_between_two_runs_leaves_nothing_at_the_broker(site, end):
    site.write("near")
    run_until_raised(site, end)
    site.write("nearer")
    with site.running():
        eventually(lambda: site.is_active("nearer"))
        eventually(lambda: site.listener.payloads(f"{BASE}/near/door")[-1] == "")
        eventually(lambda: site.heard("near", "state")[-1] == "")
        eventually(lambda: site.heard("near", "availability")[-2:] == ["offline", ""])
        assert site.heard("nearer", "availability")[-1] == "online"


@pytest.mark.long
def test_a_state_of_an_earlier_run_is_not_shown_as_known_while_the_next_one_opens_its_camera(site):
    site.write("near")
    run_until_raised(site, signal.SIGKILL)
    assert site.heard("near", "availability")[-1] == "online"
    count = len(site.listener.heard)

    def of_rule():
        return [each.payload for each in site.listener.heard[count:] if "/rule/near/" in each.topic]

    with site.running():
        eventually(of_rule)
    assert of_rule()[0] == "offline"
