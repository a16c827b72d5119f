"""Requests of people and programs to a running loop. The loop attends to them between two cycles, and never waits."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from stadimeter.app.control.client import describe_reload
from stadimeter.app.control.messages import ExplainArgs, HoldArgs, OutputsArgs, Reply, as_data, operator_command
from stadimeter.app.control.reloading import CheckedConfiguration, Reloader
from stadimeter.app.control.socket_server import Answer, Asked
from stadimeter.app.cycle import CycleRecord
from stadimeter.app.exact_json import plain
from stadimeter.config.findings import did_you_mean_or_list
from stadimeter.core.alarms.machine import show_thresholds
from stadimeter.core.decision import Decision, SafetyMode
from stadimeter.core.message import NEWS_S
from stadimeter.core.persistence import ReloadedState
from stadimeter.core.rules.explaining import Reasons, explain
from stadimeter.core.safety import could_let_act
from stadimeter.operator_actions import AnyCommand, OperatorAction, OperatorCommand

# The decisions of this many seconds can be explained afterwards.
REMEMBERED_S = 60.0


# A stop is answered this late at most, however slow the disk is; the outputs are stopped before that.
KEPT_WITHIN_S = 1.0

NOT_KEPT = "this run keeps no state, so the next one begins without the stop"
NOT_YET_KEPT = "the disk has not taken it yet, so if this run is killed, the next one may begin without the stop"

NO_BLACK_BOX = "this run has no black box: add [black_box] to its configuration, and restart it"

# Returns the requests that have come to a place since the last call. Never waits.
Take = Callable[[], list[Asked]]

# Does what a request with these arguments asks for, and answers. Called between two cycles; it never waits.
Act = Callable[[Any, Answer], None]


class Control:
    """Attends to what is asked of a running loop.

    Args:
        acts: What it does for operations that are about neither rules nor the configuration, by their names.
        is_kept: Tells whether all that shall outlive the run is in its file; None if nothing outlives it.

    Attributes:
        acts: What it does for the operations of that name.
        message_figures: Returns what came of requests that were messages; None if the run takes none.
    """

    def __init__(
        self,
        sources: Iterable[Take],
        reloader: Reloader,
        unix_s: Callable[[], float] = time.time,
        deliveries: Callable[[], list[dict[str, Any]]] = list,
        acts: Mapping[str, Act] | None = None,
        is_kept: Callable[[], bool | None] = lambda: True,
    ) -> None:
        self.message_figures: Callable[[], Mapping[str, Any] | None] = lambda: None
        self.acts = {**(acts or {})}
        self._is_kept = is_kept
        self._stops: list[tuple[float, Asked, dict[str, Any]]] = []
        self._takes = tuple(sources)
        self._reloader = reloader
        self._unix_s = unix_s
        self._deliveries = deliveries
        self._commands = 0
        self._waiting: dict[str, Asked] = {}
        self._questions: list[Asked] = []
        self._past: deque[tuple[float, Decision]] = deque()
        self._reload_for: Answer | None = None

    def reload(self, tell: Callable[[str], None]) -> None:
        """Have the configuration read again before the next cycle. May be called from a signal handler."""
        self._reload_for = lambda reply: tell(_reload_words(reply))

    def operator_commands(self) -> tuple[AnyCommand, ...]:
        """Attend to what was asked since the last cycle; return what operators want of rules and outputs now."""
        if self._reload_for is not None:
            answer, self._reload_for = self._reload_for, None
            self._reloader.ask(answer)
        taken = [asked for take in self._takes for asked in take()]
        return tuple(command for asked in taken if (command := self._dispatch(asked)) is not None)

    def change(self) -> CheckedConfiguration | None:
        """Return the configuration to apply now, if there is one."""
        return self._reloader.take()

    def changed(self, change: CheckedConfiguration, taken: ReloadedState) -> None:
        """Answer the request that a configuration was reloaded."""
        self._reloader.done(change.configuration)
        data = {name: getattr(taken, name) for name in ("kept", "changed", "added", "removed")}
        change.answer(Reply({**data, "warnings": change.warnings}))

    def answer_requests(self, record: CycleRecord) -> None:
        """Answer the requests that this cycle decided, and remember the cycle."""
        self._remember(record)
        for given in record.decision.answers:
            asked = self._waiting.pop(given.id, None)
            if asked is not None and not given.accepted:
                asked.answer(Reply(error=given.words))
            elif asked is not None and isinstance(asked.request.args, OutputsArgs):
                self._stops.append((time.monotonic() + KEPT_WITHIN_S, asked, _describe_stop(given.words, record)))
            elif asked is not None:
                asked.answer(Reply({"words": given.words, **_describe_applied(asked, record)}))
        self._answer_stops()
        questions, self._questions = self._questions, []
        for asked in questions:
            asked.answer(self._reply(asked.request.args, record))

    def _dispatch(self, asked: Asked) -> AnyCommand | None:
        """Return the command that a request is; attend to it otherwise if it is none."""
        request = asked.request
        if request.op in self.acts:
            self.acts[request.op](request.args, asked.answer)
        elif request.op == OperatorAction.CLIP.command:
            asked.answer(Reply(error=NO_BLACK_BOX))
        elif request.is_command:
            command = operator_command(request, f"asked-{self._commands + 1}")
            if refusal := self._refusal(asked, command):
                asked.answer(Reply(error=refusal))
                return None
            self._commands += 1
            self._waiting[command.id] = asked
            return command
        elif request.op == "reload":
            self._reloader.ask(asked.answer)
        elif request.op not in {"explain", "status"}:
            asked.answer(Reply(error=f"this run cannot do that: {request.op}"))
        else:
            self._questions.append(asked)
        return None

    def _refusal(self, asked: Asked, command: AnyCommand) -> str:
        """Return why the sender of a command may not give it; empty if it may."""
        if asked.may_let_act or not isinstance(command, OperatorCommand):
            return ""
        names = could_let_act(self._reloader.running.plan, command.action, command.rule)
        if not names:
            return ""
        words = f"{command.action.value} could let an output act, by {', '.join(names)}"
        return f'{words}: over MQTT that needs commands = "all" in [messenger]'

    def _answer_stops(self) -> None:
        """Answer who stopped or released the outputs, once it is in the file: a run that is killed then has kept it."""
        waiting, self._stops = self._stops, []
        for by_s, asked, done in waiting:
            is_kept = self._is_kept()
            if is_kept is False and time.monotonic() < by_s:
                self._stops.append((by_s, asked, done))
                continue
            note = (
                {True: "", None: "; " + NOT_KEPT, False: "; " + NOT_YET_KEPT}[is_kept] if "unconfirmed" in done else ""
            )
            asked.answer(Reply({**done, "words": done["words"] + note}))

    def _remember(self, record: CycleRecord) -> None:
        now_s = record.observation.now_s
        self._past.append((now_s, record.decision))
        while self._past[0][0] < now_s - REMEMBERED_S:
            self._past.popleft()

    def _reply(self, args: object, record: CycleRecord) -> Reply | Callable[[], Reply]:
        if isinstance(args, ExplainArgs):
            return self._explain(args, record.observation.now_s)
        since_s, now_s = record.observation.undelivered_since_s, record.observation.now_s
        is_overdue = since_s is not None and now_s - since_s > NEWS_S
        status = _status(record.decision) | {"alarm_undelivered": is_overdue}
        status["mounting"] = plain(record.observation.mounting) if record.observation.mounting is not None else None
        return lambda: Reply({**status, "deliveries": self._deliveries(), "commands": self.message_figures()})

    def _explain(self, args: ExplainArgs, now_s: float) -> Reply | Callable[[], Reply]:
        ago_s = args.ago_s or 0.0
        if args.at_unix_s is not None:
            ago_s = self._unix_s() - args.at_unix_s
        if ago_s < 0:
            return Reply(error="that moment is still to come")
        past = next(((at_s, decision) for at_s, decision in reversed(self._past) if at_s <= now_s - ago_s), None)
        if past is None:
            known_s = now_s - self._past[0][0]
            return Reply(error=f"only the last {known_s:.0f} s are remembered; a journal remembers all of a run")
        return lambda: _explanation(past[1], args.rule, now_s - past[0])


def _describe_stop(words: str, record: CycleRecord) -> dict[str, Any]:
    """Tell the operator who stopped or released the outputs what they must know: which outputs did not obey a stop."""
    if record.decision.safety is not SafetyMode.STOPPED:
        return {"words": words}
    obeyed = {command.output for command in record.applied}
    unconfirmed = [each.output for each in record.decision.commands if each.output not in obeyed]
    faults = {fault.output: fault.reason for fault in record.observation.output_faults}
    notes = [f"{name} did not confirm it ({faults.get(name, 'it failed')}): cut its supply" for name in unconfirmed]
    return {"words": "; ".join([words, *notes]), "unconfirmed": unconfirmed}


def _describe_applied(asked: Asked, record: CycleRecord) -> dict[str, Any]:
    """Return the command applied to an output that is held; nothing for any other request."""
    if not isinstance(asked.request.args, HoldArgs):
        return {}
    commands = [each for each in record.applied if each.output == asked.request.args.output]
    return {"applied": plain(commands[0]) if commands else None}


def _explanation(decision: Decision, rule: str, ago_s: float) -> Reply:
    names = [trace.rule for trace in decision.rules]
    if rule and rule not in names:
        return Reply(error=f"there is no rule '{rule}'; {did_you_mean_or_list(rule, names)}")
    explained = [as_data(explain(decision, name)) for name in names if rule in {"", name}]
    return Reply({"ago_s": round(ago_s, 3), "rules": explained})


def _status(decision: Decision) -> dict[str, Any]:
    """Describe the state of every rule and target, for programs."""
    rules = [
        plain(trace) | {"reason": decision.reasons.get(trace.rule, ""), "thresholds": _thresholds(decision, trace.rule)}
        for trace in decision.rules
    ]
    targets = [
        {
            "target": track.target,
            "status": track.status.value,
            "distance_m": track.distance_m if track.is_valid else None,
        }
        for track in decision.tracks
    ]
    return {
        "safety": decision.safety.value,
        "safety_reason": decision.safety_reason,
        "rules": rules,
        "targets": targets,
        "outputs": [plain(output) for output in decision.outputs],
        "figures": dict(decision.figures),
    }


def _thresholds(decision: Decision, rule: str) -> dict[str, Any]:
    """Return the thresholds of a rule that can be set, by their names."""
    alarm = decision.reasons.record_of(rule) if isinstance(decision.reasons, Reasons) else None
    return {key: plain(each) for key, each in show_thresholds(*alarm).items()} if alarm is not None else {}


def _reload_words(reply: Reply | Callable[[], Reply]) -> str:
    known = reply if isinstance(reply, Reply) else reply()
    return known.error or "the configuration was reloaded: " + describe_reload(known.data)
