"""The documents are what their published schemas say, and the schemas are what the classes say."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from jsonschema import Draft202012Validator, ValidationError

from support import report_sample, schemas
from trueplant.output import to_json
from trueplant.result import Result, build
from trueplant.result.schema import published


@pytest.mark.parametrize("name", ["result", "check", "track"])
def test_published_schemas_are_those_of_the_classes(name):
    made = schemas.generated()[f"{name}.schema.json"]
    assert (schemas.FOLDER / f"{name}.schema.json").read_text(encoding="utf-8") == schemas.text(made), (
        "a class of the results has changed: run python -m support.schemas in tests/"
    )
    assert published(f"{name}.json") == made
    Draft202012Validator.check_schema(made)


@pytest.fixture(scope="module")
def looped(tmp_path_factory) -> Result:
    return report_sample.with_loop(tmp_path_factory.mktemp("loop"))


def test_results_are_valid_and_read_back_as_they_were(looped):
    check = Draft202012Validator(published("result.json"))
    for result in (looped, report_sample.sample(), report_sample.refused(), report_sample.refused(curves=True)):
        document = json.loads(to_json(result))
        check.validate(document)
        assert build(Result, document).to_dict() == document


def test_numbers_that_are_not_finite_are_null_and_valid(looped):
    gain = replace(looped.elements[0].parameters[0], std_error=np.inf, p_value=np.nan)
    odd = replace(looped, elements=(replace(looped.elements[0], parameters=(gain,)),))
    document = json.loads(to_json(odd))
    parameter = document["elements"][0]["parameters"][0]
    assert parameter["std_error"] is None and parameter["p_value"] is None
    Draft202012Validator(published("result.json")).validate(document)


@pytest.mark.parametrize(
    ("where", "value"),
    [
        (("status",), None),
        (("elements", 0, "verdict"), 3),
        (("robustness", "margins", "plant", 0, "Ms"), "high"),
        (("provenance", "settings", "confidence"), "0.95"),
        (("methods", "direct"), [{"output": "y"}]),
        (("reasons",), [{"code": "no-such-code", "message": "", "where": ""}]),
    ],
)
def test_what_is_not_a_result_is_refused(looped, where, value):
    document = json.loads(to_json(looped))
    place = document
    for key in where[:-1]:
        place = place[key]
    place[where[-1]] = value
    with pytest.raises(ValidationError):
        Draft202012Validator(published("result.json")).validate(document)
