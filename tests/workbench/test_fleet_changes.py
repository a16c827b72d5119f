"""Giving a fleet a configuration: signed, tried, allowed, applied; and what fails changes nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec import Struct

from stadimeter.config.loader import load_configuration
from stadimeter.errors import ConfigError, StateError
from stadimeter.workbench.fleet.desired import sign, verify
from stadimeter.workbench.fleet.policy import FleetPolicy, MotionPermit, changed_motion, changed_settings
from stadimeter.workbench.fleet.receiver import Receiver
from stadimeter.workbench.fleet.reports import Trial
from stadimeter.workbench.fleet.rollout import make_cohorts
from stadimeter.workbench.fleet.trial import try_out
from support.broker import HOST, MosquittoBroker
from support.command_line import Typed, typed
from support.fleet_devices import OWN, RULES, FleetOfReceivers, GivenRun
from support.signing import Repository, allow, desired, make_key, signed
from support.simulated_run import SIMULATED_BALL

TEST = '[[tests]]\nname = "calm"\ninput = { hover = { at = "50 cm", for = "1 s" } }\nexpect.near = { raised = 7 }\n'


@pytest.fixture(scope="module")
def ada(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_key(tmp_path_factory.mktemp("ada"), "ada")


def test_only_what_was_signed_by_somebody_allowed_is_read(ada: Path, tmp_path: Path) -> None:
    signers = allow(ada, tmp_path / "allowed_signers")
    wanted = [desired(RULES, phase=phase) for phase in ("try", "apply")]
    assert [verify(each, signers) for each in sign(wanted, ada)] == [(each, "ada@example.com") for each in wanted]
    message, foreign = signed(ada, RULES), signed(make_key(tmp_path, "eve"), RULES)
    for wrong in (message.replace(b"2 m", b"9 m"), message.partition(b"\n")[0], b"[" * 50_000, b"", foreign):
        with pytest.raises(ConfigError):
            verify(wrong, signers)
    with pytest.raises(ConfigError, match="so no signature is believed"):
        verify(message, tmp_path / "nowhere")


def test_what_may_move_something_otherwise_is_named(tmp_path: Path) -> None:
    robot = f"""{SIMULATED_BALL}
[base]
driver = "simulated"
[rules.near]
when = {{ below = "1 m" }}
actuator = "motor"
[rules.stay]
actuator = "base"
follow = {{ distance = "1 m" }}
[world]
"""
    lease = "[lease of an output]"
    path = tmp_path / "a.toml"
    path.write_text(robot)
    before = load_configuration(path)
    for old, new, settings, motion in (
        ('below = "1 m"', 'below = "2 m"', (), ()),
        ('distance = "1 m"', 'distance = "2 m"', (), ("rule 'stay'",)),
        ('actuator = "motor"', 'actuator = "base"', (), ("rule 'near'",)),
        ("[world]", '[safety]\nmax_frame_age = "1 s"\n[world]', ("[safety]",), ("[safety]",)),
        ("fx_px = 600.0", "fx_px = 900.0", ("[camera.model]",), ("[camera.model]",)),
        ("[actuators.motor]\n", '[actuators.motor]\nlease = "200 ms"\n', (lease,), (lease,)),
    ):
        path.write_text(robot.replace(old, new, 1))
        after = load_configuration(path)
        assert (changed_settings(before, after), changed_motion(before, after)) == (settings, motion), new


class Device(Struct):
    receiver: Receiver
    run: GivenRun
    path: Path

    @property
    def told(self) -> tuple[str, str]:
        newest = self.receiver.report().newest
        return ("", "") if newest is None else (newest.status, newest.sentence)


def make(folder: Path, ada: Path, trial: Trial | None = None, **policy: object) -> Device:
    path = folder / "a.toml"
    if not path.exists():
        path.write_text(OWN)
    rules = FleetPolicy.model_validate({"allowed_signers": allow(ada, folder / "signers"), **policy})
    found = Trial(running_sha256="ab") if trial is None else trial
    run = GivenRun(path)
    return Device(Receiver(path, rules, "stadimeter/garage", lambda _: found, run), run, path)


def test_it_is_tried_first_and_changes_nothing_and_then_applied(tmp_path: Path, ada: Path) -> None:
    device = make(tmp_path, ada)
    device.receiver.receive(signed(ada, RULES, sequence=7))
    assert (device.told, device.path.read_text(), device.run.applied) == (("tried", ""), OWN, [])
    device.receiver.receive(signed(ada, RULES, sequence=7, phase="apply"))
    text = device.path.read_text()
    assert (device.told, device.run.applied) == (("applied", ""), [text])
    assert 'below = "2 m"' in text
    assert 'driver = "simulated"' in text, "sections that were not sent stay"
    assert [each.read_text() for each in tmp_path.glob("versions/*/a.toml")] == [OWN]
    for message, words in (
        (signed(ada, RULES, sequence=6, phase="apply"), "it is older (sequence 6) than what came before (7)"),
        (signed(ada, RULES, "stadimeter/attic"), "it is signed for stadimeter/attic, and this is stadimeter/garage"),
        (b"nonsense", "its signature is none of those"),
    ):
        device.receiver.receive(message)
        assert device.receiver.report().rejected.sentence.startswith(words)
    assert (device.path.read_text(), len(device.run.applied)) == (text, 1)


@pytest.mark.parametrize(
    ("policy", "trial", "words"),
    [
        ({}, Trial(refusal="1 of its 1 tests failed: calm"), "1 of its 1 tests failed: calm"),
        ({"change": "none"}, Trial(), "the policy of this device lets a fleet try, and change nothing"),
        ({}, Trial(settings=("[camera]",)), "lets a fleet change rules only, and this changes [camera]"),
        ({"change": "all"}, Trial(motion=("[base]",)), "moves ([base]), which was not armed"),
    ],
)
def test_what_fails_or_is_not_allowed_is_refused(
    tmp_path: Path, ada: Path, policy: dict[str, object], trial: Trial, words: str
) -> None:
    device = make(tmp_path, ada, trial, **policy)
    device.receiver.receive(signed(ada, RULES, phase="apply"))
    status, sentence = device.told
    assert (status, device.path.read_text(), device.run.applied) == ("refused", OWN, [])
    assert words in sentence


def test_motion_is_changed_where_it_was_armed_and_only_once(tmp_path: Path, ada: Path) -> None:
    device = make(tmp_path, ada, Trial(motion=("[base]",), settings=("[base]",), needs_restart=True), change="all")
    permit = MotionPermit(tmp_path / "a.fleet-motion")
    permit.give(600.0)
    device.receiver.receive(signed(ada, RULES, phase="apply"))
    assert (device.told, permit.stands()) == (("applied", ""), False)
    device.receiver.receive(signed(ada, RULES + "# again\n", phase="apply"))
    assert device.told[0] == "refused"


def test_a_run_that_falls_ill_and_a_power_cut_end_with_the_former_file(tmp_path: Path, ada: Path) -> None:
    device = make(tmp_path, ada)
    device.run.falls_ill = "the run was not well within 120 s: motor"
    device.receiver.receive(signed(ada, RULES, sequence=7, phase="apply"))
    assert device.told[0] == "rolled-back"
    assert (device.path.read_text(), device.run.applied[-1]) == (OWN, OWN)

    def cut(running_sha256: str, *, restarted: bool) -> None:
        raise KeyboardInterrupt

    device.run.await_health = cut  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        device.receiver.receive(signed(ada, RULES, sequence=8, phase="apply"))
    assert device.path.read_text() != OWN
    again = make(tmp_path, ada)
    again.receiver.recover()
    assert (again.path.read_text(), again.told[0]) == (OWN, "rolled-back")


def test_a_memory_that_is_damaged_lets_nothing_through(tmp_path: Path, ada: Path) -> None:
    (tmp_path / "a.fleet-json").write_text("{")
    with pytest.raises(StateError, match="delete it to take each configuration"):
        make(tmp_path, ada)


def test_a_trial_says_what_is_wrong_and_counts_what_a_recording_decides_otherwise(tmp_path: Path) -> None:
    path, recordings = tmp_path / "a.toml", tmp_path / "recordings"
    path.write_text(OWN + 'actuator = "motor"\n')
    recordings.mkdir()
    words = ("--seconds", 2, "--speed", 0, "--no-state", "--journal", recordings / "run.jsonl")
    assert typed("run", path, *words).returncode == 0
    policy = FleetPolicy.model_validate({"allowed_signers": tmp_path, "recording": recordings})
    assert "rules.near.when.bellow" in try_out(path, policy, OWN.replace("below", "bellow")).refusal
    assert try_out(path, policy, OWN + TEST).refusal == "1 of its 1 tests failed: calm"
    same, wider = (
        try_out(path, policy, path.read_text().replace("1 m", limit)).differences for limit in ("1 m", "3 m")
    )
    assert same is not None
    assert wider is not None
    assert (same.recording, same.differing) == ("run.jsonl", 0)
    assert 0 < wider.differing <= wider.cycles == same.cycles


def test_five_hundred_devices_are_25_and_100_and_375_spread_over_their_sites() -> None:
    names = [f"site-{number % 10}/node-{number}" for number in range(490)] + [f"lone-{n}/a" for n in range(10)]
    cohorts = make_cohorts(names)
    assert list(map(len, cohorts)) == [25, 100, 375]
    assert sorted(name for cohort in cohorts for name in cohort) == sorted(names)
    assert len({name.partition("/")[0] for name in cohorts[0]}) == 20


@pytest.mark.long
def test_a_good_configuration_reaches_every_device_and_a_bad_one_none(tmp_path: Path, ada: Path) -> None:
    broker = MosquittoBroker(tmp_path)
    broker.start()
    repository = Repository(tmp_path / "repository", ada)
    centre = tmp_path / "centre.toml"
    centre.write_text(f'[messenger]\ndriver = "mqtt"\nhost = "{HOST}"\nport = {broker.port}\nnode = "centre"\n')

    def apply(file: Path, *words: object) -> Typed:
        return typed("fleet", "apply", file, "--config", centre, "--wait", "2 s", *words)

    (tmp_path / "devices").mkdir()
    names = ("garage", "hall/press", "attic")
    fleet = FleetOfReceivers(tmp_path / "devices", allow(ada, tmp_path / "signers"), broker.port, names)
    bad = repository.commit("bad.toml", RULES + TEST, "Too eager")
    good = repository.commit("rules.toml", RULES, "Warn from 2 m on")
    try:
        with fleet.listening():
            stopped = apply(bad)
            assert stopped.returncode == 1, stopped
            assert "refused: 1 of its 1 tests failed: calm" in stopped.stderr
            assert (fleet.running, fleet.trials) == ([], 1)
            done = apply(good)
            assert (done.returncode, done.stderr) == (0, ""), done
            assert len(fleet.running) == 3
            fleet.silent.add("garage")
            back = repository.commit("own.toml", OWN, "As before")
            assert (
                "stopped: no answer within 1 s from garage" in apply(back, "--to", "garage", "--within", "1 s").stderr
            )
    finally:
        broker.stop()
