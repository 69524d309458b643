"""The JSON schema of problem files against an independent validator, and against what reading a file refuses."""

import json
import tomllib

import jsonschema
import pytest
from helpers.commands import printed
from helpers.problem_files import PROBLEMS, changed

from plough_opt.problem_file import template

SCHEMA = json.loads(printed("schema"))
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def test_it_is_a_schema_whose_parts_all_exist():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert '"null"' not in repr(SCHEMA).replace("'", '"')  # TOML has none
    for text in (template(), *(path.read_text(encoding="utf-8") for path in PROBLEMS.glob("*.toml"))):
        VALIDATOR.validate(tomllib.loads(text))


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ('tow_speed = "7.2 km/h"', "tow_speed = 7.2"),
        ('tow_speed = "7.2 km/h"', 'tow_sped = "7.2 km/h"'),
        ('"share.height"      = {', '"share.hight"      = {'),
        ("log = true", 'log = "yes"'),
        ("amplitude = 0.3,", "amplitude = 0.3, height = 2,"),
        ("half_angle      = { at_most", "half_angle      = { at_mots"),
    ],
)
def test_a_mistake_is_marked_that_reading_refuses_too(refusal, right, wrong):
    text = changed((right, wrong))
    assert refusal(text)
    assert not VALIDATOR.is_valid(tomllib.loads(text))


def test_meanings_and_units_are_those_of_the_registry():
    speed = SCHEMA["$defs"]["SceneFile"]["properties"]["tow_speed"]
    assert "V0" in speed["description"]
    assert speed["examples"] == ["7.2 km/h"]
