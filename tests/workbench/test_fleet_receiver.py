"""What a device does with what it is sent: real signatures and files; what a trial and a run answer is given."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec import Struct

from stadimeter.errors import StateError
from stadimeter.workbench.fleet.policy import FleetPolicy, MotionPermit
from stadimeter.workbench.fleet.receiver import Receiver
from stadimeter.workbench.fleet.reports import Trial
from stadimeter.workbench.fleet.trial import try_out
from support.fleet_devices import OWN, RULES, GivenRun
from support.signing import allow, make_key, signed


class Device(Struct):
    receiver: Receiver
    run: GivenRun
    path: Path
    trials: list[str]

    @property
    def told(self) -> tuple[str, str]:
        newest = self.receiver.report().newest
        return ("", "") if newest is None else (newest.status, newest.sentence)


@pytest.fixture(scope="module")
def ada(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_key(tmp_path_factory.mktemp("ada"), "ada")


def make(folder: Path, ada: Path, trial: Trial | None = None, **policy: object) -> Device:
    path = folder / "a.toml"
    if not path.exists():
        path.write_text(OWN)
    rules = FleetPolicy.model_validate({"allowed_signers": allow(ada, folder / "signers"), **policy})
    trials: list[str] = []

    def given(text: str) -> Trial:
        trials.append(text)
        return Trial(running_sha256="ab") if trial is None else trial

    run = GivenRun(path)
    return Device(Receiver(path, rules, "stadimeter/garage", given, run), run, path, trials)


def test_it_is_tried_first_and_changes_nothing_and_then_applied(tmp_path: Path, ada: Path) -> None:
    device = make(tmp_path, ada)
    device.receiver.receive(signed(ada, RULES, sequence=7))
    assert (device.told, device.path.read_text(), device.run.applied) == (("tried", ""), OWN, [])
    assert device.receiver.report().why_not() == "tried, and not applied"
    device.receiver.receive(signed(ada, RULES, sequence=7, phase="apply"))
    text = device.path.read_text()
    assert (device.told, device.run.applied) == (("applied", ""), [text])
    assert 'below = "2 m"' in text
    assert 'driver = "simulated"' in text
    assert device.trials == [text], "it was tried once"
    report = device.receiver.report()
    assert report.applied is not None
    assert (report.applied.by, report.applied.revision.reason) == ("ada@example.com", "why not")
    assert (report.is_edited, report.why_not()) == (False, "")
    kept = list(tmp_path.glob("versions/*/a.toml"))
    assert [each.read_text() for each in kept] == [OWN]


def test_one_that_is_sent_again_does_nothing_also_after_a_restart_and_an_edit(tmp_path: Path, ada: Path) -> None:
    message = signed(ada, RULES, sequence=7, phase="apply")
    make(tmp_path, ada).receiver.receive(message)
    (tmp_path / "a.toml").write_text(OWN)
    device = make(tmp_path, ada)
    device.receiver.receive(message)
    device.receiver.receive(signed(ada, RULES, sequence=7, phase="try"))
    assert (device.path.read_text(), device.trials) == (OWN, [])
    assert device.receiver.report().why_not() == "its file was edited on the device since"


def test_what_is_older_or_for_another_device_or_of_nobody_is_rejected_and_counted(tmp_path: Path, ada: Path) -> None:
    make(tmp_path, ada).receiver.receive(signed(ada, RULES, sequence=7))
    device = make(tmp_path, ada)
    others = [
        (signed(ada, RULES, sequence=6, phase="apply"), "it is older (sequence 6) than what came before (7)"),
        (signed(ada, RULES, "stadimeter/attic"), "it is signed for stadimeter/attic, and this is stadimeter/garage"),
        (signed(ada, RULES + "#", sequence=7), "another configuration came with the same sequence, 7"),
        (b"nonsense", f"its signature is none of those whom {tmp_path}/signers allows"),
    ]
    for count, (message, words) in enumerate(others, start=1):
        device.receiver.receive(message)
        rejected = device.receiver.report().rejected
        assert (rejected.sentence.startswith(words), rejected.count) == (True, count), rejected
    assert (device.told, device.trials, device.run.applied) == (("tried", ""), [], [])


@pytest.mark.parametrize(
    ("policy", "trial", "words"),
    [
        ({}, Trial(refusal="1 of its 1 tests failed: calm"), "1 of its 1 tests failed: calm"),
        ({"change": "none"}, Trial(), "the policy of this device lets a fleet try, and change nothing"),
        ({}, Trial(settings=("[camera]",)), "lets a fleet change rules only, and this changes [camera]"),
        (
            {"change": "all"},
            Trial(motion=("[base]", "rule 'stay'")),
            "moves ([base], rule 'stay'), which was not armed",
        ),
        ({}, Trial(motion=("rule 'stay'",)), "was not armed here with `stadimeter fleet arm"),
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
    device.receiver.receive(signed(ada, RULES, sequence=7))
    assert permit.stands()
    device.receiver.receive(signed(ada, RULES, sequence=7, phase="apply"))
    assert (device.told, permit.stands()) == (("applied", ""), False)
    assert device.run.applied[0].startswith("restart: ")


def test_a_run_that_refuses_or_falls_ill_gets_its_former_file_back(tmp_path: Path, ada: Path) -> None:
    device = make(tmp_path, ada)
    device.run.refuses = "nothing was changed: it has a fault"
    device.receiver.receive(signed(ada, RULES, sequence=7, phase="apply"))
    back = "the former file was put back, and the run goes by it"
    assert device.told == ("rolled-back", f"nothing was changed: it has a fault; {back}")
    device.run.refuses, device.run.falls_ill = "", "the run was not well within 120 s: motor"
    device.receiver.receive(signed(ada, RULES, sequence=8, phase="apply"))
    assert device.told == ("rolled-back", f"the run was not well within 120 s: motor; {back}")
    assert (device.path.read_text(), device.run.applied[-1]) == (OWN, OWN)
    assert device.receiver.report().applied is None


def test_without_a_run_that_could_say_how_it_is_nothing_is_applied(tmp_path: Path, ada: Path) -> None:
    device = make(tmp_path, ada)
    device.run.is_there = False
    device.receiver.receive(signed(ada, RULES, phase="apply"))
    assert (device.told, device.path.read_text()) == (("refused", "no instance of stadimeter is running"), OWN)


def test_a_power_cut_in_the_middle_ends_with_the_former_file(tmp_path: Path, ada: Path) -> None:
    device = make(tmp_path, ada)

    def cut(running_sha256: str, *, restarted: bool) -> None:
        assert device.told[0] == "applying"
        raise KeyboardInterrupt

    device.run.await_health = cut  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        device.receiver.receive(signed(ada, RULES, sequence=7, phase="apply"))
    assert device.path.read_text() != OWN
    again = make(tmp_path, ada)
    again.receiver.recover()
    assert again.path.read_text() == OWN
    assert again.told[0] == "rolled-back"
    assert again.told[1].startswith("it was interrupted while it was applied; the former file was put back")
    again.receiver.recover()
    assert len(again.run.applied) == 1


def test_a_memory_that_is_damaged_or_cannot_be_written_lets_nothing_through(tmp_path: Path, ada: Path) -> None:
    device = make(tmp_path, ada)
    (tmp_path / "a.fleet-json").mkdir()
    with pytest.raises(StateError, match="cannot be written"):
        device.receiver.receive(signed(ada, RULES, phase="apply"))
    assert device.path.read_text() == OWN
    (tmp_path / "a.fleet-json").rmdir()
    (tmp_path / "a.fleet-json").write_text("{")
    with pytest.raises(StateError, match="delete it to take each configuration"):
        make(tmp_path, ada)


def test_a_file_that_is_gone_or_no_toml_is_refused(tmp_path: Path, ada: Path) -> None:
    device = make(tmp_path, ada)
    device.receiver.receive(signed(ada, "[rules", sequence=7))
    assert device.told[0] == "refused"
    assert "not valid TOML" in device.told[1]
    device.path.unlink()
    device.receiver.receive(signed(ada, RULES, sequence=8))
    assert device.told == ("refused", f"{device.path}: there is no such file")


def test_a_report_is_short_whatever_is_in_the_configuration(tmp_path: Path, ada: Path) -> None:
    device = make(tmp_path, ada, Trial(refusal="x" * 10_000))
    device.receiver.receive(signed(ada, RULES))
    assert len(device.told[1]) == 501


def test_a_real_trial_says_what_is_wrong(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text(OWN)
    policy = FleetPolicy.model_validate({"allowed_signers": tmp_path, "recording": tmp_path / "none"})
    wrong = try_out(path, policy, OWN.replace("below", "bellow"))
    assert "rules.near.when.bellow" in wrong.refusal
    test = '[[tests]]\nname = "calm"\ninput = {{ hover = {{ at = "50 cm", for = "1 s" }} }}\nexpect.near = {{ {} }}\n'
    failing = try_out(path, policy, OWN + test.format("raised = 7"))
    assert failing.refusal == "1 of its 1 tests failed: calm"
    good = try_out(path, policy, OWN.replace("1 m", "2 m") + test.format("raised = 1"))
    assert (good.refusal, good.tests, good.settings, good.motion, good.needs_restart) == ("", 1, (), (), False)
    assert (good.not_replayed, good.differences) == ("this device has no recording of its own", None)
    required = policy.model_copy(update={"replay": "required"})
    assert try_out(path, required, OWN).refusal == (
        "this device has no recording of its own, and its policy requires a replay"
    )
    (tmp_path / "none").write_text("no journal\n")
    assert try_out(path, policy, OWN).not_replayed.startswith("its recording cannot be replayed: ")


def test_a_file_that_was_edited_during_the_trial_is_left_alone(tmp_path: Path, ada: Path) -> None:
    device = make(tmp_path, ada)
    look = device.run.look

    def edit() -> None:
        look()
        device.path.write_text(OWN + "# edited\n")

    device.run.look = edit  # type: ignore[method-assign]
    device.receiver.receive(signed(ada, RULES, phase="apply"))
    assert device.told == ("refused", "the file was edited on the device meanwhile")
    assert device.path.read_text() == OWN + "# edited\n"
    assert device.run.applied == []
