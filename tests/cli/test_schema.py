"""The command `schema` prints what editors complete from."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from stadimeter.cli.main import app
from stadimeter.config.schema import configuration_schema


@pytest.mark.long
def test_the_schema_is_printed_and_nothing_else() -> None:
    result = CliRunner().invoke(app, ["schema"])
    assert result.exit_code == 0
    assert json.loads(result.stdout) == configuration_schema()
    assert result.stderr == ""
