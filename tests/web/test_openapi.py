"""The description of the API says what there is, and what a real run answers is as it says."""

import http.client
import json
import re
import struct

import jsonschema
import pytest
from openapi import openapi_document

from stadimeter.app.control.messages import ARGS
from stadimeter.cli.operate import ALARM_ACTIONS, OUTPUT_ACTIONS
from stadimeter.operator_actions import OperatorAction
from stadimeter.testing.rig import eventually
from stadimeter.web.routes import PAGE_OPERATIONS, Right
from support.browser import served
from support.each_case import each_case

API = openapi_document()
DESCRIBED = [place for place in PAGE_OPERATIONS if place.right > Right.OPEN and place.op not in {"index", "static"}]


def validator(name):
    schema = {"$ref": f"#/components/schemas/{name}", "components": API["components"]}
    return jsonschema.Draft202012Validator(schema)


def test_it_has_every_path_of_the_table_and_no_other():
    found = {(method.upper(), path) for path, methods in API["paths"].items() for method in methods}
    assert found == {(place.method, place.path) for place in DESCRIBED}


@each_case("place", DESCRIBED)
def test_it_tells_the_right_the_names_and_the_kind_of_answer(place):
    told = API["paths"][place.path][place.method.lower()]
    assert told["x-right"] == place.right.name.lower()
    names = {each["name"]: each["in"] for each in told.get("parameters", ())}
    assert set(re.findall(r"{(\w+)}", place.path)) == {name for name, where in names.items() if where == "path"}
    assert set(place.query) <= set(names)
    assert place.media in {"", *told["responses"]["200"]["content"]}
    assert "requestBody" not in told or place.changes


def test_every_operator_action_is_a_path_of_the_page_a_request_of_the_run_and_a_command():
    paths = {each.op for each in PAGE_OPERATIONS if each.to == "run" and each.names_operator}
    commands = {*ALARM_ACTIONS.values(), *OUTPUT_ACTIONS.values()}
    for action in OperatorAction:
        assert action.command in paths
        assert action.command in ARGS
        assert action in commands or action in {
            OperatorAction.CLIP,
            OperatorAction.CONFIRM_MOUNTING,
        }  # `record`, `site`


def test_its_schemas_are_schemas_and_each_is_used():
    for schema in API["components"]["schemas"].values():
        jsonschema.Draft202012Validator.check_schema(schema)
    named = set(re.findall(r'"#/components/schemas/(\w+)"', json.dumps(API)))
    assert named | {"Snapshot", "Gone"} == set(API["components"]["schemas"])  # these two are in a stream


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    with served(tmp_path_factory.mktemp("page")) as here:
        eventually(lambda: ask(here, "/api/v1/session")[1]["run"]["is_running"])
        eventually(lambda: ask(here, "/api/v1/status")[1]["targets"][0]["distance_m"])
        yield here


def ask(here, path):
    connection = http.client.HTTPConnection(here.url.removeprefix("http://"), timeout=120)
    try:
        connection.request("GET", path)
        answer = connection.getresponse()
        return answer.status, json.loads(answer.read())
    finally:
        connection.close()


@pytest.mark.long
@pytest.mark.parametrize(
    ("path", "name"),
    [
        ("session", "Session"),
        ("status", "Status"),
        ("alarms", "Alarms"),
        ("rules/far/explanation", "Explanation"),
        ("rules/far/explanation?ago_s=0.1", "Explanation"),
        ("recordings", "Recordings"),
        ("configuration", "Configuration"),
        ("setup", "Setup"),
        ("nothing", "Error"),
        ("live?image=x", "Error"),
        ("rules/nothing/explanation", "Error"),
        ("configuration/versions/nothing", "Error"),
    ],
)
def test_a_real_run_answers_as_it_says(here, path, name):
    status, data = ask(here, f"/api/v1/{path}")
    validator(name).validate(data)
    assert (status == 200) == (name != "Error")


@pytest.mark.long
def test_so_do_its_snapshots_in_which_nothing_is_untold(here):
    connection = http.client.HTTPConnection(here.url.removeprefix("http://"), timeout=120)
    connection.request("GET", "/api/v1/live?image=plain")
    answer = connection.getresponse()
    pictures = 0
    while pictures < 3:  # a snapshot has none where no frame has come since the one before
        lengths = struct.unpack(">II", answer.read(8))
        snapshot, picture = (answer.read(length) for length in lengths)
        data = json.loads(snapshot)
        validator("Snapshot").validate(data)
        assert picture[:2] in {b"", b"\xff\xd8"}
        pictures += bool(picture)
    connection.close()
    for name, found in (
        ("Snapshot", data),
        ("Target", data["targets"][0]),
        ("Rule", data["rules"][0]),
        ("Output", data["outputs"][0]),
        ("Health", data["health"]),
        ("Frame", data["frame"]),
    ):
        assert set(found) == set(API["components"]["schemas"][name]["properties"]), name
