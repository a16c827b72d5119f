"""What a broker has of a run that ends suddenly, and keeps of rules that are gone: real broker, real processes.

``STADIMETER_KILLS=50 pytest tests/scenario/test_nothing_is_lost.py -m long -s`` measures more kills.
"""

import json
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager

import pytest

from stadimeter.testing.rig import eventually
from support.broker import BrokerAccess, MosquittoBroker
from support.mqtt_listener import MqttListener
from support.programs import needs
from support.simulated_run import SIMULATED_BALL
from support.tunnel import Tunnel

pytestmark = needs("mosquitto")


# Alarms that are raised while the broker is away outlive the sudden end of the program: real broker, real processes.

KILLS = int(os.environ.get("STADIMETER_KILLS", "3"))
# A last resort: the figure that is printed is that of the documentation, at a machine that is not busy.
ARRIVAL_MAX_S = 60.0

BACK_AND_FORTH = """
[world]
path = [
    { at = "0 s", x = "3 m", y = "0 m" },
    { at = "0.6 s", x = "1 m", y = "0 m" },
    { at = "1.2 s", x = "3 m", y = "0 m" },
]

[rules.near]
when = { below = "2 m" }
on_delay = "0 s"
off_delay = "0 s"

[rules.nearer]
when = { below = "1.5 m" }
on_delay = "0 s"
off_delay = "0 s"
"""


class Site:
    """A program, and a broker that is away until the tunnel to it is mended. A subscriber is there all the time."""

    def __init__(self, folder, closing):
        self.folder = folder
        self.broker = MosquittoBroker(folder, BrokerAccess())
        self.broker.start()
        closing.callback(self.broker.stop)
        self.tunnel = Tunnel(self.broker.port)
        closing.callback(self.tunnel.cut)
        self.listener = closing.enter_context(MqttListener(self.broker.port))
        self.configuration = folder / "run.toml"
        messenger = f'[messenger]\ndriver = "mqtt"\nport = {self.tunnel.port}\nnode = "it"\n'
        self.configuration.write_text(SIMULATED_BALL + messenger + BACK_AND_FORTH)

    @contextmanager
    def running(self, journal, *options):
        """Run the program until it is killed."""
        command = [sys.executable, "-m", "stadimeter", "run", self.configuration, "--journal", self.folder / journal]
        with (self.folder / f"{journal}.txt").open("wb") as words:
            process = subprocess.Popen([*command, *options], stdin=subprocess.DEVNULL, stdout=words, stderr=words)
        try:
            yield process
        finally:
            process.kill()
            process.wait()

    def events(self, journal):
        """Return what the journal of a run says that happened, without the line that was being written."""
        path = self.folder / journal
        lines = path.read_text().split("\n")[:-1] if path.exists() else []
        return [event for line in lines[1:] for event in json.loads(line)["decision"]["events"]]


def alarms(events):
    return [event for event in events if event["kind"] in {"raised", "cleared"}]


@pytest.fixture
def site(tmp_path):
    with ExitStack() as closing:
        yield Site(tmp_path, closing)


def killed_without_a_broker(site, kill_after_s):
    """Let alarms be raised while the broker is away, kill the program, and return what had happened."""
    state = ("--state", site.folder / "state.sqlite3")
    with site.running("first.jsonl", *state) as process:
        eventually(lambda: alarms(site.events("first.jsonl")))
        time.sleep(kill_after_s)  # any moment will do
        process.send_signal(signal.SIGKILL)
        process.wait()
    return site.events("first.jsonl")


def arrivals(site, happened, is_broker_first):
    """Bring broker and program back; return what came from before, and after how long all alarms had come."""

    def came():
        heard = [json.loads(each.payload) for each in site.listener.heard if "/event/" in each.topic]
        # Which run an event is of is said by `info`: rules that chatter may have no event in the second for a minute.
        (*_, now) = ["", *site.listener.payloads("stadimeter/it/info")]
        return [each for each in heard if not each["id"].startswith(json.loads(now)["boot_id"])] if now else []

    if is_broker_first:
        site.tunnel.mend()
    with site.running("second.jsonl", "--state", site.folder / "state.sqlite3"):
        if not is_broker_first:
            eventually(lambda: alarms(site.events("second.jsonl")))
            site.tunnel.mend()
        began_s = time.monotonic()
        wanted = {(event["source"], event["kind"], event["sequence"]) for event in alarms(happened)}
        try:
            eventually(lambda: wanted <= {named(each) for each in came()})
        except AssertionError:
            return came(), float("inf")
        return came(), time.monotonic() - began_s


def named(payload):
    """Return what tells an event from others, as the journal has it."""
    source = payload.get("rule") or payload["source"]
    return source, payload["event_type"], int(payload["id"].rpartition("-")[2])


@pytest.mark.long
@pytest.mark.parametrize("number", range(KILLS))
def test_alarms_from_before_a_sudden_end_without_a_broker_arrive_with_their_own_time(site, number):
    chance = random.Random(number)  # noqa: S311 - the same moments each time
    happened = killed_without_a_broker(site, kill_after_s=chance.uniform(0.0, 4.0))
    came, seconds = arrivals(site, happened, is_broker_first=number % 2 == 0)
    found = {named(each) for each in came}
    lost = [event for event in alarms(happened) if (event["source"], event["kind"], event["sequence"]) not in found]
    print(f"\nkill {number}: alarms {len(alarms(happened))}, lost {len(lost)}, all there after {seconds:.1f} s")
    assert not lost
    assert len(came) == len({each["id"] for each in came}), "each came once"
    assert [each["ts"] for each in came] == sorted(each["ts"] for each in came)
    assert all(each.get("replayed") for each in came), "they are history"
    assert seconds <= ARRIVAL_MAX_S


@pytest.mark.long
def test_what_a_run_without_a_state_file_could_not_deliver_is_counted_and_said_at_its_end(site):
    with site.running("first.jsonl") as process:
        eventually(lambda: len(alarms(site.events("first.jsonl"))) > 3)
        process.send_signal(signal.SIGTERM)
        process.wait(120)
    lost = len(site.events("first.jsonl"))
    said = (site.folder / "first.jsonl.txt").read_text()
    assert f"warning: while ending: given up: {lost} messages (127.0.0.1:{site.tunnel.port} refused" in said


# What a broker keeps of a whole program says no more than is known: real broker, real processes, no state file.

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


class ChangingSite:
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
def changing_site(tmp_path):
    broker = MosquittoBroker(tmp_path)
    broker.start()
    try:
        with MqttListener(broker.port) as listener:
            yield ChangingSite(tmp_path, broker, listener)
    finally:
        broker.stop()


def run_until_raised(changing_site, end):
    with changing_site.running() as process:
        eventually(lambda: changing_site.is_active("near"))
        eventually(lambda: changing_site.listener.payloads(f"{BASE}/near/door"))
        process.send_signal(end)
        process.wait()


@pytest.mark.long
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM])
def test_a_rule_that_is_renamed_between_two_runs_leaves_nothing_at_the_broker(changing_site, end):
    changing_site.write("near")
    run_until_raised(changing_site, end)
    changing_site.write("nearer")
    with changing_site.running():
        eventually(lambda: changing_site.is_active("nearer"))
        eventually(lambda: changing_site.heard("near", "state")[-1] == "")
        eventually(lambda: changing_site.heard("near", "availability")[-2:] == ["offline", ""])
        eventually(lambda: changing_site.heard("nearer", "availability")[-1:] == ["online"])


@pytest.mark.long
def test_a_state_of_an_earlier_run_is_not_shown_as_known_while_the_next_one_opens_its_camera(changing_site):
    changing_site.write("near")
    run_until_raised(changing_site, signal.SIGKILL)
    assert changing_site.heard("near", "availability")[-1] == "online"
    count = len(changing_site.listener.heard)

    def of_rule():
        return [each.payload for each in changing_site.listener.heard[count:] if "/rule/near/" in each.topic]

    with changing_site.running():
        eventually(of_rule)
    assert of_rule()[0] == "offline"
