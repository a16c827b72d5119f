"""Talking to a running instance, as a user does: with commands in another terminal."""

import json
import os
import re
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from stadimeter.testing.rig import eventually
from support.broker import free_port
from support.command_line import typed
from support.simulated_run import SIMULATED_BALL

NEAR = """
[rules.near]
actuator = "motor"
when = { below = "3 m" }
on_delay = "0 s"
ack = "required"
shelve_max = "1 h"
"""
FAR = """
[rules.far]
when = { above = "1 m" }
on_delay = "0 s"
"""
WORLD = """
[world]
path = [{ at = "0 s", x = "2 m", y = "0 m" }]
loop = false
"""


class Terminal:
    """A user's environment, in folders of a test."""

    def __init__(self, folder):
        self.folder = folder
        self.config = folder / "door.toml"
        self.write(NEAR)
        self.environ = {
            **os.environ,
            "NO_COLOR": "1",
            "COLUMNS": "120",
            "XDG_RUNTIME_DIR": str(folder / "r"),
            "XDG_STATE_HOME": str(folder / "s"),
        }
        self.environ.pop("RUNTIME_DIRECTORY", None)
        self.environ.pop("STATE_DIRECTORY", None)
        self.started = []

    def write(self, *rules):
        self.config.write_text("".join((SIMULATED_BALL, *rules, WORLD)))

    def type(self, *words):
        """Type a command and wait for its end."""
        return typed(*words, env=self.environ)

    def start(self, config=None, *words, until="near raised"):
        """Start a run, and wait until it says that its rule is active, or something else."""
        process = subprocess.Popen(
            [sys.executable, "-m", "stadimeter", "run", str(config or self.config), *map(str, words)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=self.environ,
            start_new_session=True,  # as a service: without a terminal
        )
        instance = Instance(process)
        self.started.append(instance)
        instance.wait_for(until)
        return instance


class Instance:
    """A run in the background."""

    def __init__(self, process):
        self.process = process
        self.said = {"out": "", "err": ""}
        streams = (("out", process.stdout), ("err", process.stderr))
        self.threads = [threading.Thread(target=self._read, args=each, daemon=True) for each in streams]
        for thread in self.threads:
            thread.start()

    def _read(self, name, stream):
        for line in stream:
            self.said[name] += line

    def wait_for(self, words):
        assert eventually(lambda: words in self.said["out"] + self.said["err"] or self.process.poll() is not None)
        assert words in self.said["out"] + self.said["err"], self.said

    def end(self):
        self.process.terminate()
        return self.wait()

    def wait(self):
        code = self.process.wait(120)
        for thread in self.threads:
            thread.join(120)
        self.process.stdout.close()
        self.process.stderr.close()
        return code


@pytest.fixture
def terminal(tmp_path_factory):
    terminal = Terminal(tmp_path_factory.mktemp("t"))
    yield terminal
    for instance in terminal.started:
        if instance.process.poll() is None:
            instance.process.kill()
            instance.wait()


@pytest.mark.long
def test_an_alarm_is_acknowledged_shelved_and_taken_out_while_it_runs(terminal):
    instance = terminal.start()
    done = terminal.type("alarm", "ack", "near", "--by", "Zoë", "--why", "seen")
    assert (done.returncode, done.stderr) == (0, "")
    instance.wait_for("near acknowledged")
    assert terminal.type("alarm", "shelve", "near", "--for", "30 min").returncode == 0
    assert "near: active, shelved: " in terminal.type("status").stdout
    assert terminal.type("alarm", "unshelve", "--all").returncode == 0
    assert terminal.type("alarm", "take-out", "near", "--json").stdout.startswith('{"words": ')
    assert terminal.type("alarm", "put-back", "near").returncode == 0
    assert terminal.type("alarm", "observe", "near").stdout == "observe: near\n"
    assert "observed: " in terminal.type("status").stdout
    assert terminal.type("alarm", "act", "--all").stdout == "act: near\n"
    assert instance.end() == 0
    assert "by Zoë: seen" in instance.said["out"]


@pytest.mark.long
def test_stopped_outputs_stay_stopped_over_a_kill_until_they_are_released(terminal):
    state = ("--state", terminal.folder / "door.sqlite3")
    instance = terminal.start(None, *state)
    done = terminal.type("outputs", "stop", "--by", "Zoë", "--why", "a child")
    assert (done.returncode, done.stdout) == (0, "the outputs are stopped until released\n")
    instance.process.kill()
    instance.wait()
    terminal.start(None, *state, until="STOPPED: stopped until released, by Zoë: a child")
    status = terminal.type("status").stdout
    assert status.splitlines()[1].startswith("outputs are safe: stopped until released, by Zoë: a child")
    assert "but 'motor' is kept safe: stopped" in terminal.type("explain", "near").stdout
    assert terminal.type("outputs", "release").returncode == 0
    assert terminal.type("status").stdout.splitlines()[1] == "outputs may act"


@pytest.mark.long
def test_a_run_records_from_a_command_until_another(terminal):
    if shutil.disk_usage(terminal.folder).free < 600e6:
        pytest.skip("no recording begins with less than 500 MB left on the disk")
    terminal.start()
    begun = terminal.type("record")
    assert (begun.returncode, begun.stderr) == (0, "")
    name = Path(begun.stdout.removeprefix("recording: ").strip())
    assert terminal.type("record").returncode == 2, "one at a time"
    assert terminal.type("record", "--stop").stdout == f"recorded: {name.name}\n"
    assert name.stat().st_size > 0


@pytest.mark.long
def test_a_stop_without_a_name_stops_every_instance_even_if_another_was_killed(terminal):
    other, killed = terminal.folder / "garage.toml", terminal.folder / "killed.toml"
    for config in (other, killed):
        config.write_text(terminal.config.read_text())
    instances = [terminal.start(), terminal.start(other)]
    last = terminal.start(killed)
    last.process.kill()
    last.wait()
    done = terminal.type("stop", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["unconfirmed"] == []
    for instance in instances:
        instance.wait_for("STOPPED: stopped until released")
    assert terminal.type("outputs", "release").returncode == 2


@pytest.mark.long
def test_what_is_refused_is_one_clear_line_and_2(terminal):
    terminal.start()
    for words, expected in [
        (("alarm", "reset", "near"), "near"),
        (("alarm", "ack", "nera"), "nera"),
        (("alarm", "shelve", "near", "--for", "2 h"), "up to 1 h"),
        (("alarm", "shelve", "near", "--for", "soon"), "'soon' is not a number with a unit"),
        (("alarm", "shelve", "near", "--for", "0 s"), "no time at all"),
    ]:
        done = terminal.type(*words)
        assert done.returncode == 2, words
        (line,) = done.stderr.splitlines()
        assert line.startswith("error: ")
        assert expected in line


@pytest.mark.parametrize("command", ["ack", "reload", "status", "stop"])
def test_without_a_running_instance_it_says_so(terminal, command):
    done = terminal.type(*(["alarm", "ack", "near"] if command == "ack" else [command]))
    assert done.returncode == 2
    assert done.stderr == ("error: no instance of stadimeter is running; start one with `stadimeter run CONFIG`\n")


@pytest.mark.long
def test_of_several_instances_one_must_be_named(terminal):
    other = terminal.folder / "garage.toml"
    other.write_text(terminal.config.read_text())
    terminal.start()
    terminal.start(other)
    done = terminal.type("status")
    assert done.returncode == 2
    assert "several instances run; say which one with --config or --socket:" in done.stderr
    assert str(terminal.config) in done.stderr
    assert str(other) in done.stderr
    assert terminal.type("alarm", "ack", "near", "--config", other).returncode == 0
    (unseen,) = json.loads(terminal.type("status", "--json", "--config", terminal.config).stdout)["rules"]
    (seen,) = json.loads(terminal.type("status", "--json", "--config", other).stdout)["rules"]
    assert (unseen["acknowledged"], seen["acknowledged"]) == (False, True)
    done = terminal.type("status", "--config", terminal.folder / "none.toml")
    assert "no instance runs with" in done.stderr


@pytest.mark.long
def test_an_answer_names_the_configuration_its_age_and_whether_the_file_has_changed_since(terminal):
    terminal.start()
    for words in (("status",), ("explain", "near")):
        first = terminal.type(*words).stdout.splitlines()[0]
        assert re.fullmatch(rf"{terminal.config}, loaded [\d.]+ s ago \(process \d+\)", first)
        told = json.loads(terminal.type(*words, "--json").stdout)["instance"]
        assert (told["configuration"], told["is_file_changed"]) == (str(terminal.config), False)
    terminal.write(NEAR, FAR)
    before = json.loads(terminal.type("status", "--json").stdout)["instance"]
    assert before["is_file_changed"]
    assert "; the file has changed since: `stadimeter reload` applies it" in terminal.type("status").stdout
    assert terminal.type("reload").returncode == 0
    told = json.loads(terminal.type("status", "--json").stdout)["instance"]
    assert told["configuration_age_s"] < before["configuration_age_s"]
    assert not told["is_file_changed"]


@pytest.mark.long
def test_no_other_instance_answers_for_one_that_was_killed(terminal):
    other = terminal.folder / "garage.toml"
    other.write_text(terminal.config.read_text())
    garage, door = terminal.start(other), terminal.start()
    door.process.kill()
    door.wait()
    for words in (("status",), ("explain", "near"), ("alarm", "ack", "near")):
        done = terminal.type(*words)
        assert done.returncode == 2
        assert "the instance that began last was killed, or had no power" in done.stderr
        assert str(other) in done.stderr
        assert terminal.type(*words, "--config", terminal.config).returncode == 2
        assert terminal.type(*words, "--config", other).returncode == 0
    garage.end()
    terminal.start(other)  # it began after that one ended
    assert terminal.type("status").returncode == 0


@pytest.mark.long
def test_a_socket_of_another_configuration_than_the_named_one_is_not_asked(terminal):
    terminal.start()
    place = terminal.folder / "r" / "stadimeter" / "door.sock"
    assert terminal.type("status", "--socket", place, "--config", terminal.config).returncode == 0
    done = terminal.type("status", "--socket", place, "--config", terminal.folder / "garage.toml")
    assert done.returncode == 2
    assert f"the instance there runs {terminal.config}, and not " in done.stderr


@pytest.mark.long
def test_the_status_says_what_waits_for_a_broker_that_is_away(terminal):
    terminal.write(NEAR, f'[messenger]\ndriver = "mqtt"\nport = {free_port()}\n')
    terminal.start()
    assert "messenger: not delivered yet: 2, given up: 0" in terminal.type("status").stdout  # target seen, near raised
    status = json.loads(terminal.type("status", "--json").stdout)
    assert status["deliveries"] == [{"to": "messenger", "waiting": 2, "given_up": 0}]
    eventually(lambda: json.loads(terminal.type("status", "--json").stdout)["alarm_undelivered"])
    assert "an alarm has not reached broker or service" in terminal.type("status").stdout


@pytest.mark.long
def test_a_threshold_is_moved_while_it_runs_and_stays_so_over_a_kill_until_the_configuration_changes_it(terminal):
    state = terminal.folder / "s" / "stadimeter" / "door.sqlite3"
    instance = terminal.start(None, "--state", state)
    wrong = terminal.type("alarm", "set-threshold", "near", "0.5")
    assert (wrong.returncode, wrong.stderr) == (
        2, "error: args.value: '0.5' has no unit; write it with one, such as '60 cm'\n",
    )  # fmt: skip
    done = terminal.type("alarm", "set-threshold", "near", "50 cm", "--by", "Zoë", "--why", "the dog")
    assert (done.returncode, done.stdout, done.stderr) == (0, "set-threshold: near\n", "")
    instance.wait_for("near cleared")
    assert "below is 0.50 m (1.6 ft), the configuration says 3.00 m (9.8 ft): by Zoë: the dog" in instance.said["out"]
    assert "below set to 0.5 m" in terminal.type("status").stdout
    (rule,) = json.loads(terminal.type("status", "--json").stdout)["rules"]
    found = rule["thresholds"]["below"]
    assert (found["value"], found["configured"], found["unit"], found["set_by"]) == (0.5, 3.0, "m", "Zoë")
    said = "`below` is 0.50 m (1.6 ft), set by Zoë "
    assert said in terminal.type("explain", "near").stdout
    eventually(lambda: b'"thresholds":[{' in state.with_name("door.sqlite3-wal").read_bytes())
    instance.process.kill()
    instance.wait()
    again = terminal.start(None, "--state", state, until="")
    eventually(lambda: said in terminal.type("explain", "near").stdout)
    assert again.end() == 0
    is_set = "`near`: below is set to 0.50 m (1.6 ft) by Zoë; the configuration says 3.00 m (9.8 ft)."
    assert is_set in terminal.type("check", terminal.config).stdout
    assert is_set in json.loads(terminal.type("check", terminal.config, "--json").stdout)["describes"]
    terminal.write(NEAR.replace("3 m", "2.5 m"))
    assert is_set not in terminal.type("check", terminal.config).stdout


def test_a_damaged_state_file_is_a_warning_and_the_run_goes_on(terminal):
    state = terminal.folder / "door.sqlite3"
    words = ("run", terminal.config, "--state", state, "--seconds", 1, "--speed", 0)
    assert terminal.type(*words).stderr == ""
    whole = state.read_bytes()
    damaged = whole[:4096] + bytes(len(whole) - 4096)
    state.write_bytes(damaged)
    done = terminal.type(*words)
    assert done.returncode == 0
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"warning: {state} is damaged: ")
    assert line.endswith(f"it is now {state}.damaged-1, and the alarms start anew")
    assert state.with_name("door.sqlite3.damaged-1").read_bytes() == damaged


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo, lambda path: path.symlink_to(path.name)])
def test_what_can_be_no_state_file_is_an_error_before_anything_moves(terminal, make):
    state = terminal.folder / "door.sqlite3"
    make(state)
    done = terminal.type("run", terminal.config, "--state", state, "--seconds", 1, "--speed", 0)
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: {state} cannot be used: ")
    assert len(done.stderr.splitlines()) == 1


def test_a_state_file_that_cannot_be_written_is_a_warning_and_the_run_goes_on(terminal):
    done = terminal.type("run", terminal.config, "--state", "/proc/none.sqlite3", "--seconds", 1, "--speed", 0)
    assert done.returncode == 0
    assert done.stderr.startswith("warning: /proc/none.sqlite3 cannot be written: ")


@pytest.mark.long
def test_a_simulation_keeps_no_state_unless_a_file_is_named(terminal):
    terminal.start().end()
    assert not (terminal.folder / "s").exists()


def test_a_socket_that_cannot_be_made_where_it_was_asked_for_is_one_clear_line_and_2(terminal):
    done = terminal.type("run", terminal.config, "--socket", "/proc/none.sock", "--seconds", 1)
    assert done.returncode == 2
    assert done.stderr.startswith("error: /proc/none.sock: cannot listen there: ")


ALL_DAY = """
[rules.all-day]
when = { time = { between = ["00:00", "24:00"] } }
on_delay = "0 s"
"""


def test_a_clock_that_the_user_trusts_is_right_enough_for_a_rule_that_goes_by_it(terminal):
    terminal.write(ALL_DAY)
    done = terminal.type("run", terminal.config, "--trust-clock", "--seconds", 1, "--speed", 0)
    assert done.returncode == 0
    assert "all-day raised" in done.stdout
