"""Giving a fleet a configuration: cohorts, git, and real receivers at a real broker."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stadimeter.errors import ConfigError
from stadimeter.workbench.fleet.rollout import make_cohorts, read_committed, signing_key
from support.broker import HOST, MosquittoBroker
from support.command_line import Typed, typed
from support.fleet_devices import OWN, RULES, FleetOfReceivers
from support.signing import Repository, allow, make_key

TEST = '[[tests]]\nname = "calm"\ninput = { hover = { at = "50 cm", for = "1 s" } }\nexpect.near = { raised = 7 }\n'
FAILING = RULES + TEST

NAMES = st.lists(st.from_regex(r"[a-c](/[a-z]{1,3})?", fullmatch=True), max_size=60)


@given(NAMES)
def test_every_device_is_in_exactly_one_cohort_and_the_first_is_never_empty(names: list[str]) -> None:
    cohorts = make_cohorts(names)
    assert sorted(name for cohort in cohorts for name in cohort) == sorted(set(names))
    assert make_cohorts(reversed(names)) == cohorts
    assert bool(cohorts[0]) is bool(names)
    count, sent = len(set(names)), 0
    for cohort, percent in zip(cohorts, (5, 25, 100), strict=True):
        sent += len(cohort)
        assert percent * count <= 100 * sent < percent * count + 100


def test_five_hundred_devices_are_25_and_100_and_375_spread_over_their_sites() -> None:
    cohorts = make_cohorts(
        [f"site-{number % 10}/node-{number}" for number in range(490)] + [f"lone-{n}/a" for n in range(10)]
    )
    assert list(map(len, cohorts)) == [25, 100, 375]
    assert len({name.partition("/")[0] for name in cohorts[0]}) == 20


@pytest.fixture(scope="module")
def ada(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_key(tmp_path_factory.mktemp("ada"), "ada")


@pytest.fixture
def repository(tmp_path: Path, ada: Path) -> Repository:
    return Repository(tmp_path / "repository", ada)


def test_a_configuration_is_read_from_git_and_from_nowhere_else(repository: Repository, ada: Path) -> None:
    file = repository.commit("rules.toml", RULES, "Warn from 2 m on")
    first = read_committed(file)
    assert (first.configuration, first.reason) == (RULES, "Warn from 2 m on")
    assert re.fullmatch("[0-9a-f]{40}", first.commit)
    file.write_text("[rules]\n")
    with pytest.raises(ConfigError, match="has changes that are not committed"):
        read_committed(file)
    repository.commit("rules.toml", "[rules]\n", "No rules")
    assert read_committed(file, "HEAD~1") == first
    for name, revision in (("none.toml", "HEAD"), ("rules.toml", "nowhere"), ("rules.toml", "--help")):
        with pytest.raises(ConfigError, match="git says: "):
            read_committed(repository.folder / name, revision)
    assert signing_key(file) == ada
    repository.git("config", "user.signingkey", "0xABCDEF")
    with pytest.raises(ConfigError, match="name the key to sign with: --key FILE"):
        signing_key(file)


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[MosquittoBroker]:
    made = MosquittoBroker(tmp_path)
    made.start()
    yield made
    made.stop()


@pytest.fixture
def centre(tmp_path: Path, broker: MosquittoBroker) -> Path:
    """Return a file that names the broker, and nothing else."""
    file = tmp_path / "centre.toml"
    file.write_text(f'[messenger]\ndriver = "mqtt"\nhost = "{HOST}"\nport = {broker.port}\nnode = "centre"\n')
    return file


def devices(folder: Path, ada: Path, broker: MosquittoBroker, *names: str) -> FleetOfReceivers:
    (folder / "devices").mkdir()
    return FleetOfReceivers(folder / "devices", allow(ada, folder / "signers"), broker.port, names)


def apply(file: Path, centre: Path, *words: object) -> Typed:
    return typed("fleet", "apply", file, "--config", centre, "--wait", "2 s", *words)


@pytest.mark.long
def test_a_good_configuration_reaches_every_device_and_a_bad_one_none(
    tmp_path: Path, ada: Path, broker: MosquittoBroker, centre: Path, repository: Repository
) -> None:
    fleet = devices(tmp_path, ada, broker, "garage", "hall/press", "hall/lathe", "attic")
    bad = repository.commit("bad.toml", FAILING, "Too eager")
    good = repository.commit("rules.toml", RULES, "Warn from 2 m on")
    with fleet.listening():
        stopped = apply(bad, centre)
        assert stopped.returncode == 1, stopped
        assert "refused: 1 of its 1 tests failed: calm" in stopped.stderr
        assert "run by no device because of this" in stopped.stderr
        assert (fleet.running, fleet.trials) == ([], 1)
        done = apply(good, centre)
        assert (done.returncode, done.stderr) == (0, ""), done
        assert "4 devices have begun to run" in done.stdout
        assert len(fleet.running) == 4
        again = apply(good, centre)
        assert "runs it already: attic, garage, hall/lathe, hall/press" in again.stdout
        assert "0 devices have begun" in again.stdout
        explained = typed("fleet", centre, "--explain", "hall/press", "--wait", "2 s").stdout
        assert "applied: Warn from 2 m on (commit " in explained
        assert "signed by ada@example.com" in explained
        assert (
            "says nothing of its configuration" in typed("fleet", centre, "--explain", "cellar", "--wait", "1 s").stderr
        )
        back = repository.commit("own.toml", OWN, "As before")
        fleet.runs["garage"].is_there = False
        halted = apply(back, centre, "--to", "garage", "--why", "a trial")
        assert "stopped: garage refused: no instance of stadimeter is running" in halted.stderr


@pytest.mark.long
def test_a_device_that_does_not_answer_stops_it_and_does_not_apply_it_later(
    tmp_path: Path, ada: Path, broker: MosquittoBroker, centre: Path, repository: Repository
) -> None:
    fleet = devices(tmp_path, ada, broker, "garage")
    file = repository.commit("rules.toml", RULES, "Warn from 2 m on")
    fleet.silent.add("garage")
    with fleet.listening():
        stopped = apply(file, centre, "--within", "1 s")
        assert "stopped: no answer within 1 s from garage" in stopped.stderr
    fleet.silent.clear()
    with fleet.listening():
        assert fleet.receivers["garage"].report().newest is None
        other = make_key(tmp_path, "eve")
        rejected = apply(file, centre, "--key", other)
        assert rejected.returncode == 1
        assert "stopped: garage refused: its signature is none of those whom" in rejected.stderr
    assert fleet.running == []


@pytest.mark.long
def test_what_cannot_be_sent_is_said_in_a_line(
    tmp_path: Path, ada: Path, broker: MosquittoBroker, centre: Path, repository: Repository
) -> None:
    file = repository.commit("rules.toml", RULES, "Warn from 2 m on")
    wrong = {
        "cellar: not online, or without a receiver of configurations": ("--to", "cellar"),
        "--within: ": ("--within", "soon"),
        "git says: ": ("--commit", "nowhere"),
        "cannot be signed with /nowhere": ("--key", "/nowhere"),
    }
    with devices(tmp_path, ada, broker, "garage").listening():
        for error, words in wrong.items():
            found = apply(file, centre, *words)
            assert (found.returncode, error in found.stderr) == (2, True), found


def test_a_computer_whose_clock_was_never_set_sends_nothing(
    centre: Path, repository: Repository, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stadimeter.workbench.fleet.desired.clock_trouble", lambda: "the clock here says 1970-01-01")
    found = apply(repository.commit("rules.toml", RULES, "Warn from 2 m on"), centre)
    assert found.returncode == 2
    assert found.stderr.startswith("error: the clock here says 1970-01-01: set it first")


@pytest.mark.long
def test_a_bad_configuration_for_five_hundred_devices_is_stopped_in_the_first_cohort_and_nobody_runs_it(
    tmp_path: Path, ada: Path, broker: MosquittoBroker, centre: Path, repository: Repository
) -> None:
    fleet = devices(tmp_path, ada, broker, *(f"site-{number % 10}/node-{number}" for number in range(500)))
    bad = repository.commit("bad.toml", FAILING, "Too eager")
    good = repository.commit("rules.toml", RULES, "Warn from 2 m on")
    with fleet.listening():
        stopped = apply(bad, centre, "--wait", "10 s")
        assert stopped.returncode == 1, stopped
        assert "tests failed: calm" in stopped.stderr
        assert fleet.running == []
        assert 1 <= fleet.trials <= 25
        done = apply(good, centre, "--wait", "10 s")
        assert "500 devices have begun to run" in done.stdout, done
        assert len(fleet.running) == 500
