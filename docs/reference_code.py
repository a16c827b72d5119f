"""The pages of the reference that come from code rather than from the models of a configuration."""

from __future__ import annotations

import ast
import inspect
import itertools
import re
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import typer
from openapi import openapi_document
from prometheus_client.parser import text_string_to_metric_families

from stadimeter.app.control.mqtt_requests import OFFERS
from stadimeter.app.messages import Reporter, health_figures
from stadimeter.cli.main import PANELS, app
from stadimeter.core import message as topics
from stadimeter.core.camera_pose import CameraPose
from stadimeter.core.decision import RuleStatus, RuleTrace
from stadimeter.operator_actions import SWITCHES, OperatorAction
from stadimeter.web.metrics import exposition
from stadimeter.workbench.setup.interview import FIRST_STEPS
from stadimeter.workbench.setup.recipe_steps import BROKER, USUAL, base_drivers
from stadimeter.workbench.setup.recipes import driver_blanks, load_recipes
from stadimeter.workbench.setup.target import offered_kinds
from support.metered_run import metered_run
from support.observing import Rehearsal
from support.two_rules import NEAR, plan_of

SHARED = "Options of several commands"
SOURCE = Path(__file__).parent.parent / "src" / "stadimeter"
NOON = "2026-06-01T12:00:00.000+00:00"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table of Markdown."""
    lines = (head, ["---"] * len(head), *rows)
    return "\n".join(
        "| " + " | ".join(" ".join(cell.replace("|", r"\|").split()) for cell in line) + " |" for line in lines
    )


# Commands -------------------------------------------------------------------------------------------------------------


def commands_page() -> Iterator[str]:
    """Yield each command: what it does, an example, and its options; those of several commands once."""
    group: Any = typer.main.get_command(app)
    found = {
        panel: [one for name in names for one in _below(f"stadimeter {name}", group.load(name))]
        for panel, names in PANELS.items()
    }
    counts = Counter(row for commands in found.values() for _, command in commands for row in _options(command))
    yield from (f"## {SHARED}", table(("option", "what it does"), [row for row, count in counts.items() if count > 1]))
    for panel, commands in found.items():
        yield f"## {panel}"
        for path, command in commands:
            about, *_ = (command.help or "").split("\n\n")
            yield f"### `{path}`\n\n{' '.join(about.split())}"
            if example := re.search(r"^- `(.*)`$", command.help or "", re.MULTILINE):
                yield f"    {example[1]}"
            rows = _options(command)
            if own := [row for row in rows if counts[row] == 1]:
                yield table(("option", "what it does"), own)
            if shared := [row[0].strip("`").split()[0].rstrip(",") for row in rows if counts[row] > 1]:
                yield f"{SHARED}: {', '.join(f'`{each}`' for each in shared)}."


def _below(path: str, command: Any) -> Iterator[tuple[str, Any]]:
    """Yield a command with its path, and those of a group."""
    yield path, command
    for name, each in getattr(command, "commands", {}).items():
        if not each.hidden:
            yield from _below(f"{path} {name}", each)


def _options(command: Any) -> list[tuple[str, str]]:
    """Return the arguments and options of a command, each with one line."""
    given = [each for each in command.params if each.name != "help" and not getattr(each, "hidden", False)]
    return [_option(each) for each in given if getattr(each, "help", "")]


def _option(parameter: Any) -> tuple[str, str]:
    is_option, default = parameter.param_type_name == "option", parameter.default
    name = ", ".join(parameter.opts) if is_option else parameter.metavar or parameter.name
    takes = f" {parameter.metavar}" if is_option and parameter.metavar else ""
    words, *_ = re.split(r"(?<=[a-z)])\. (?=[A-Z])", getattr(parameter, "help", "") or "")
    is_shown = isinstance(default, str | int | float) and not isinstance(default, bool) and default != ""
    return f"`{name}{takes}`", words.rstrip(".") + (f"; default {default}" if is_shown else "") + "."


# Findings -------------------------------------------------------------------------------------------------------------


def findings_page() -> Iterator[str]:
    """Yield each code with what is said and what helps, as far as that stands in the source."""
    found: dict[str, list[tuple[str, str, str]]] = {
        "error": [(f"`{code}`", SAID_ELSEWHERE[code], "") for code in ("other", "test")],
        "warning": [],
    }
    for code, severity, message, remedy in findings():
        is_made_elsewhere = not WORD.search(message) and code in SAID_ELSEWHERE
        words, helps = SAID_ELSEWHERE[code] if is_made_elsewhere else message, remedy if WORD.search(remedy) else ""
        found[severity].append((f"`{code}`", words.removeprefix("… / "), helps.removeprefix("… / ")))
    for severity, rows in found.items():
        yield f"## {severity.capitalize()}s"
        yield table(("code", "what it says", "what helps"), sorted(set(rows)))


MAX_NAMES, WORD = 3, re.compile(r"\w{3}")
SAID_ELSEWHERE = {
    "bad-value": "a value, a unit or a word that is not known, or keys that contradict each other",
    "driver": "there is no driver of this name",
    "driver-lacks": "the camera or the port is not there or not yours to open, or a library or a file is missing",
    "not-for-motion": "a stream without `latency`, or one that loses packets: nothing moves on its pictures",
    "off-centre": "the optical centre is more than a tenth of the picture from its middle",
    "other": "what has no code of its own",
    "test": "a test of `[[tests]]` that cannot be run; `stadimeter run` does not mind",
}
"""What stands for messages of the source that are made elsewhere, by their code."""
WARNING_FILES = ("warnings.py", "secrets.py", "feasibility.py", "certificate.py", "this_computer.py")


def findings() -> Iterator[tuple[str, str, str, str]]:
    """Yield each finding that the source makes with a code: code, severity, message, remedy; … for what varies."""
    for path in sorted(SOURCE.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        shared = [pair for node in tree.body for pair in _assigned(node)]
        for function in ast.walk(tree):
            for call in ast.walk(function) if isinstance(function, ast.FunctionDef) else ():
                if isinstance(call, ast.Call) and getattr(call.func, "id", "") in {"Finding", "Problem"}:
                    own = [pair for node in ast.walk(function) for pair in _assigned(node)]
                    before = [pair for pair in own if pair[1].lineno <= call.lineno]
                    yield from _finding(call, dict([*shared, *sorted(before, key=lambda pair: pair[1].lineno)]), path)


def _finding(call: ast.Call, names: Mapping[str, ast.expr], path: Path) -> Iterator[tuple[str, str, str, str]]:
    given = {word.arg: word.value for word in call.keywords}
    is_finding = getattr(call.func, "id", "") == "Finding"
    places = ("path", "message", "hint", "code") if is_finding else ("message", "file", "line", "column", "key", "hint")
    given |= dict(zip(places, call.args, strict=False))
    for code in _codes(given.get("code"), names):
        severity = "warning" if path.name in WARNING_FILES and code != "bad-value" else "error"
        yield code, severity, _text(given.get("message"), names), _text(given.get("hint"), names)


def _codes(node: ast.expr | None, names: Mapping[str, ast.expr]) -> list[str]:
    match node:
        case ast.Constant(value=str(text)) if text:
            return [text]
        case ast.Name(id=name) if name in names:
            return _codes(names[name], names)
        case ast.IfExp(body=one, orelse=other):
            return [*_codes(one, names), *_codes(other, names)]
    return []


def _assigned(node: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Yield the names that a statement gives values, and these."""
    match node:
        case ast.Assign(targets=[ast.Name(id=name)], value=value):
            yield name, value
        case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
            pairs = zip(targets, values, strict=False)
            yield from ((each.id, value) for each, value in pairs if isinstance(each, ast.Name))


def _text(node: ast.expr | None, names: Mapping[str, ast.expr], depth: int = 0) -> str:
    """Return a text as it stands in the source, with … in place of what is only known when it is made."""
    text = "…"
    match node:
        case None:
            text = ""
        case ast.Constant(value=str(words)):
            text = words
        case ast.JoinedStr(values=parts):
            text = "".join(_text(each, names, depth) if isinstance(each, ast.Constant) else "…" for each in parts)
        case ast.Name(id=name) if name in names and depth < MAX_NAMES:
            text = _text(names[name], names, depth + 1)
        case ast.IfExp(body=one, orelse=other):
            text = " / ".join(dict.fromkeys(filter(None, (_text(one, names, depth), _text(other, names, depth)))))
        case ast.BinOp(left=one, right=other):
            text = _text(one, names, depth) + _text(other, names, depth)
        case ast.Call(func=ast.Name(id=name)) if name.startswith("did_you_mean"):
            text = "the likely one is offered"
    return text


# Topics ---------------------------------------------------------------------------------------------------------------


MORE_KEYS = {
    "explain": ("rule", "ago_s"), "record": ("do",), "snapshot": ("quality",), **dict.fromkeys(SWITCHES, ("value",)),
}  # fmt: skip


def topics_page() -> Iterator[str]:
    """Yield each topic of MQTT, and a payload that the program really sends there; then the requests."""
    payloads = {each.topic: each.payload for each in _messages()}
    for topic in topics.OWN_TOPICS:
        kept = f"for {topic.expires_s} s with MQTT 5" if topic.expires_s else "yes" if topic.retain else "no"
        words = documented(topics)[topic]
        yield f"## `{topic.path.replace('*', 'NAME')}`\n\n{words} QoS {topic.qos}; kept by the broker: {kept}."
        if payload := next((text for path, text in payloads.items() if topic.matches(path)), ""):
            yield f"```json\n{payload}\n```" if payload.startswith("{") else f"Payload: `{payload}`"
    yield "## Requests\n\n`request/ACTION` takes a JSON object. `commands` in `[messenger]` must be at least as here."
    actions = {each.value: each for each in OperatorAction} | {name: off for name, (_, off) in SWITCHES.items()}
    rows = []
    for name, (op, needs_all) in OFFERS.items():
        keys, summary = MORE_KEYS.get(name, ()), f"As `{op}` at the control socket"
        if (action := actions.get(name)) is not None:
            rule = () if action.is_on_outputs else ("rule",)
            keys, summary = (*rule, *action.takes, *keys, "by", "why"), action.summary
        rows.append((f"`{name}`", ", ".join(f"`{each}`" for each in keys), "all" if needs_all else "alarms", summary))
    yield table(("action", "keys beside `transaction`", "`commands`", "what it does"), rows)


def documented(module: Any) -> Mapping[Any, str]:
    """Return the texts below the constants of a module, by their values."""
    body = ast.parse(Path(module.__file__).read_text(encoding="utf-8")).body
    found = {}
    for one, text in itertools.pairwise(body):
        match one, text:
            case ast.Assign(targets=[ast.Name(id=name)]), ast.Expr(value=ast.Constant(value=str(words))):
                found[getattr(module, name)] = " ".join(words.replace("``", "`").split())
    return found


def _messages() -> Iterator[topics.Message]:
    """Yield messages of a run in which an alarm was raised, as they are sent."""
    reporter = Reporter(boot_id="6f1c2d0e9b7a4c35a1d2e3f405162738")
    run = Rehearsal(plan_of(NEAR))
    run.see(3.0)
    run.see(0.4)
    run.see(0.4)
    run.tell("set-threshold", "near", by="zoe", value=0.6)
    for _, decision in run.decisions:
        yield from reversed(reporter.messages(run.now_s, lambda: NOON, decision))
    pose = CameraPose(
        captured_at_s=0.0, position_m=(1.0, -2.0, 0.5), orientation=(0.0, 0.0, 0.389, 0.921),
        covariance=tuple(1e-4 * (row == column) for row in range(6) for column in range(6)), tags=(3, 5),
    )  # fmt: skip
    yield from reporter.pose(0.0, lambda: NOON, pose)
    with tempfile.TemporaryDirectory() as folder, metered_run(Path(folder)) as metered:
        metered.cycle()
        figures = {**health_figures(metered.feed.snapshot(0.0).health, 0, 0), "disk_free_bytes": 12_000_000_000}
    yield from reporter.health(0.0, lambda: NOON, 0.0, lambda: figures)
    yield reporter.info("9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08")


ALERT = re.compile(r"- alert: (\w+)$.*?summary: \"(.*?)\"$", re.MULTILINE | re.DOTALL)

# Metrics, API, answers ------------------------------------------------------------------------------------------------


def metrics_page() -> Iterator[str]:
    """Yield each metric of a run in which everything is known."""
    with tempfile.TemporaryDirectory() as folder, metered_run(Path(folder)) as run:
        run.cycle(rules=(RuleTrace(rule="near", status=RuleStatus.IDLE, active=False),))
        families: Any = run.metrics()
        text = exposition(families).decode()
    rows = []
    for family in text_string_to_metric_families(text):
        labels = sorted({label for each in family.samples for label in each.labels})
        name = family.name + ("_total" if family.type == "counter" else "")
        rows.append((f"`{name}`", family.type, ", ".join(f"`{each}`" for each in labels), family.documentation))
    yield table(("metric", "kind", "labels", "what it is"), rows)
    file = SOURCE.parents[1] / "deploy/prometheus/stadimeter-alerts.yml"
    alerts = re.findall(ALERT, file.read_text(encoding="utf-8"))
    yield "## Alerts\n\nThey are no safety function: what must act at once is a rule."
    yield table(("alert", "what it says"), [(f"`{name}`", re.sub(r"{{.*?}}", "…", says)) for name, says in alerts])


def api_page() -> Iterator[str]:
    """Yield each path of the API."""
    rows = [
        (f"`{method.upper()} {path}`", about["x-right"], about["summary"])
        for path, methods in openapi_document()["paths"].items()
        for method, about in methods.items()
    ]
    yield table(("path", "permission", "what it does"), rows)


def answers_page() -> Iterator[str]:
    """Yield each question of `stadimeter init`: the first ones, those of a target, those of recipes and bases."""
    yield "## For every configuration"
    yield _answers((step.key, (inspect.getdoc(type(step)) or "").splitlines()[0], "") for step in FIRST_STEPS)
    yield "## Targets\n\n`target` is one of these; the keys below are asked where a target needs them."
    yield table(("`target`", "what it is"), [(f"`{kind.key}`", kind.title) for kind in offered_kinds().values()])
    blanks = [blank for kind in offered_kinds().values() for blank in kind.blanks]
    asked = ((each.key, each.text + (f" Write {each.form}." if each.form else ""), each.ready) for each in blanks)
    yield _answers(asked)
    yield "## Recipes\n\n`recipe` is one or several of these names."
    for recipe in load_recipes().values():
        yield f"### `{recipe.key}`\n\n{recipe.title[0].upper()}{recipe.title[1:]}."
        rows = [(f"{recipe.key}_{blank.key}", blank.text, blank.ready) for blank in recipe.blanks]
        if recipe.output not in {"", "base", "mqtt"}:
            rows.append((f"{recipe.key}_output", "What it drives, or `screen`.", recipe.output))
        if rows:
            yield _answers(rows)
    yield "## Robots and messages"
    options = (blank for model in base_drivers().values() if model for blank in driver_blanks(model, "base_"))
    rows = [(each.key, each.text, "" if each.ready.startswith("/dev") else each.ready) for each in (BROKER, *options)]
    yield _answers([("base", "The driver of the robot's base, or `screen`.", USUAL), *rows])


def _answers(rows: Iterable[tuple[str, str, str]]) -> str:
    """Return a table of questions, each once."""
    asked = dict.fromkeys((f"`{key}`", text, f"`{ready}`" if ready else "") for key, text, ready in rows)
    return table(("key", "question", "answer, if none is given"), [*asked])


CODE_PAGES = {
    "commands": commands_page, "findings": findings_page, "topics": topics_page, "metrics": metrics_page,
    "api": api_page, "setup-answers": answers_page,
}  # fmt: skip
