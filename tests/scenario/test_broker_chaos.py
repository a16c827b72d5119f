"""Brokers that die, dead links, full disks: every alarm arrives, in order. Real broker, real processes.

``STADIMETER_KILLS=50 pytest tests/scenario/test_broker_chaos.py -m long -s`` measures more kills.
"""

import json
import os
import random
import shutil
import signal
import subprocess
import time
from contextlib import ExitStack
from itertools import groupby
from statistics import median

import pytest

from scenario.test_nothing_is_lost import BACK_AND_FORTH, KILLS, Site, alarms, named
from stadimeter.core.message import Message
from stadimeter.messaging.mqtt import MqttOptions, PahoMessenger
from stadimeter.testing.rig import eventually
from support.mqtt_listener import MqttListener
from support.programs import needs

pytestmark = [pytest.mark.long, pytest.mark.timeout(1200), needs("mosquitto")]

MANY = 5000

# Last resorts: the figures that are printed are those of the documentation, at a machine that is not busy.
BACK_MAX_S = NOTICED_MAX_S = 60.0

# On the run's own clock.
FALLBACK_MAX_S = 6.0

# Each rule is raised and cleared once a minute: more often would be chattering, which is held.
RULES = 250

SWEEP = """
[world]
path = [
    { at = "0 s", x = "3.1 m", y = "0 m" },
    { at = "30 s", x = "0.9 m", y = "0 m" },
    { at = "60 s", x = "3.1 m", y = "0 m" },
]
""" + "".join(
    f"""
[rules.near-{number}]
when = {{ below = "{3 - 2 * number / RULES:.3f} m" }}
on_delay = "0 s"
off_delay = "0 s"
"""
    for number in range(RULES)
)

FALLBACK = """
[rules.unheard]
when = { undelivered_for = "5 s" }
actuator = "motor"
off_delay = "0 s"
"""


@pytest.fixture
def site(tmp_path):
    with ExitStack() as closing:
        site = Site(tmp_path, closing)
        text = site.configuration.read_text().replace(BACK_AND_FORTH, SWEEP + FALLBACK)
        site.configuration.write_text(text)
        yield site


def events_heard(listeners):
    """Return the events that arrived, each once: as it came first."""
    heard = [json.loads(each.payload) for listener in listeners for each in listener.heard if "/event/" in each.topic]
    return list({each["id"]: each for each in reversed(heard)}.values())[::-1]


def missing(happened, heard):
    found = {named(each) for each in heard}
    return [each for each in alarms(happened) if (each["source"], each["kind"], each["sequence"]) not in found]


def assert_in_order_per_rule(heard):
    of_rules = sorted((each for each in heard if "rule" in each), key=lambda each: (each["rule"], each["id"][:32]))
    for _, events in groupby(of_rules, key=lambda each: (each["rule"], each["id"][:32])):
        numbers = [int(each["id"].rpartition("-")[2]) for each in events]
        assert numbers == sorted(numbers)


def state_of(site):
    return "--state", site.folder / "state.sqlite3"


def test_alarms_survive_a_broker_that_is_killed_again_and_again(site):
    chance = random.Random(1)  # noqa: S311 - the same moments each time
    backs_s, listeners = [], [site.listener]
    with ExitStack() as closing, site.running("run.jsonl", *state_of(site)):
        site.tunnel.mend()
        eventually(lambda: site.listener.heard)
        for _ in range(KILLS):
            time.sleep(chance.uniform(0.0, 2.0))  # any moment will do
            # What a broker has acknowledged and not passed on dies with it, and no program can help that.
            site.tunnel.cut()
            listeners[-1].drain()
            site.broker.stop()
            time.sleep(chance.uniform(0.0, 6.0))
            site.broker.start()  # it has forgotten everything
            listeners.append(closing.enter_context(MqttListener(site.broker.port)))
            site.tunnel.mend()
            began_s = time.monotonic()
            eventually(lambda: any("/event/" in each.topic for each in listeners[-1].heard))
            backs_s.append(time.monotonic() - began_s)
        happened = site.events("run.jsonl")
        eventually(lambda: not missing(happened, events_heard(listeners)))
        heard = events_heard(listeners)
    print(f"\nbroker killed {KILLS} times: {len(alarms(happened))} alarms, none lost")
    print(f"back after {median(backs_s):.1f} s, at worst {max(backs_s):.1f} s")
    assert_in_order_per_rule(heard)
    assert {each.get("replayed", False) for each in heard} == {True, False}
    assert max(backs_s) <= BACK_MAX_S


def test_a_link_that_is_dead_is_noticed_and_a_buzzer_sounds_meanwhile(site):
    with site.running("run.jsonl", *state_of(site)):
        site.tunnel.mend()
        eventually(lambda: any("/event/" in each.topic for each in site.listener.heard))
        before = len(alarms(site.events("run.jsonl")))
        began_s = time.monotonic()
        site.tunnel.clog()
        said = site.folder / "run.jsonl.txt"
        eventually(lambda: "has stopped answering" in said.read_text())
        noticed_s = time.monotonic() - began_s
        eventually(lambda: [each for each in site.events("run.jsonl") if named_kind(each) == ("unheard", "raised")])
        site.tunnel.cut()
        site.tunnel.mend()
        events = site.events("run.jsonl")
        eventually(lambda: not missing(events, events_heard([site.listener])))
        eventually(lambda: [each for each in site.events("run.jsonl") if named_kind(each) == ("unheard", "cleared")])
    raised = next(each for each in events if named_kind(each) == ("unheard", "raised"))
    # The first alarm after the link went dead may have been on the wire before that: then it is the next.
    first = [each for each in alarms(events)[before:] if each["source"] != "unheard"][:2]
    late_s = raised["at_s"] - first[0]["at_s"]
    print(f"\na dead link is noticed after {noticed_s:.1f} s; the fallback began {late_s:.2f} s after the first alarm")
    assert late_s <= FALLBACK_MAX_S + first[1]["at_s"] - first[0]["at_s"]
    assert noticed_s <= NOTICED_MAX_S
    assert_in_order_per_rule(events_heard([site.listener]))


def named_kind(event):
    return event["source"], event["kind"]


def test_five_thousand_alarms_that_waited_for_a_broker_arrive_in_order(site):
    messenger = PahoMessenger(MqttOptions(port=site.tunnel.port, node="it"))
    messenger.open()
    for number in range(MANY):
        messenger.publish(Message(topic="event/alarm", payload=f'{{"id":"{number}"}}', qos=1))
    site.tunnel.mend()
    began_s = time.monotonic()
    eventually(lambda: not messenger.trouble() and not messenger.undelivered())
    print(f"\n{MANY} alarms arrived {time.monotonic() - began_s:.1f} s after the broker was back")
    messenger.close()
    eventually(lambda: len([each for each in site.listener.heard if "/event/" in each.topic]) >= MANY)
    heard = [json.loads(each.payload)["id"] for each in site.listener.heard if "/event/" in each.topic]
    assert heard == [str(number) for number in range(MANY)]
    assert messenger.given_up == 0


def test_a_full_disk_loses_no_alarm_of_a_run_that_goes_on(site):
    small = site.folder / "small"
    small.mkdir()
    if (
        os.geteuid()
        or not shutil.which("mount")
        or subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", small], check=False).returncode
    ):
        pytest.skip("needs root, who may mount")
    try:
        with site.running("run.jsonl", "--state", small / "state.sqlite3") as process:
            eventually(lambda: len(alarms(site.events("run.jsonl"))) > 40)
            eventually(lambda: "cannot be written" in (site.folder / "run.jsonl.txt").read_text())
            site.tunnel.mend()
            happened = site.events("run.jsonl")
            eventually(lambda: not missing(happened, events_heard([site.listener])))
            process.send_signal(signal.SIGTERM)
            process.wait(120)
    finally:
        subprocess.run(["umount", "-l", small], check=True)
    assert_in_order_per_rule(events_heard([site.listener]))
