"""The schema says of each field what it is, in which unit; the committed copy is the same."""

from __future__ import annotations

import json
from typing import Any

import pytest
from pydantic import BaseModel

from scanrender.resources import data_folder
from scanrender.settings.pipeline import Pipeline
from scanrender.settings.schema import pipeline_schema
from scanrender.settings.validation import models_in


def sections(model: type[BaseModel] = Pipeline) -> list[type[BaseModel]]:
    found = [model]
    for info in model.model_fields.values():
        for inner in models_in(info.annotation):
            found += [section for section in sections(inner) if section not in found]
    return found


FIELDS = [
    (section, name, info)
    for section in sections()
    for name, info in section.model_fields.items()
    if name != "type" and not models_in(info.annotation)
]


@pytest.mark.parametrize(
    ("section", "name", "info"), FIELDS, ids=[f"{s.__name__}.{n}" for s, n, _ in FIELDS]
)
def test_each_field_has_a_sentence_and_its_numbers_a_unit(section: Any, name: str, info: Any):
    assert info.description, f"{section.__name__}.{name} says nothing"
    assert info.description.endswith(".")
    extra = info.json_schema_extra or {}
    shape = json.dumps(section.model_json_schema()["properties"][name])
    is_number = '"number"' in shape or '"integer"' in shape
    plain = {"version", "stages", "buffer_frames"}
    assert bool(extra.get("unit")) == is_number or name in plain
    units = ("_mm", "_px", "_deg", "_s", "_mm2", "_ev")
    if name.endswith(units):
        said = {"mm2": "mm²", "ev": "EV"}.get(name.rsplit("_", 1)[1], name.rsplit("_", 1)[1])
        assert extra.get("unit") == said, "the name and the unit agree"


def test_sections_have_a_sentence_too():
    for section in sections():
        assert section.__doc__, section.__name__
        assert section.model_config["extra"] == "forbid"


def test_numbers_have_a_range():
    for section, name, _ in FIELDS:
        text = json.dumps(section.model_json_schema()["properties"][name])
        if '"number"' in text or '"integer"' in text:
            bounded = "inimum" in text or "const" in text
            assert bounded or name in {"buffer_frames", "default_albedo"}, (section, name)


def test_the_committed_schema_is_the_one_that_the_models_make():
    path = data_folder("configs") / "schema" / "pipeline.schema.json"
    committed = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None
    assert committed == json.loads(json.dumps(pipeline_schema())), (
        "run: scanrender schema > configs/schema/pipeline.schema.json"
    )


def test_schema_knows_extends_and_refuses_the_unknown():
    schema = pipeline_schema()
    assert schema["$schema"].endswith("2020-12/schema")
    assert "extends" in schema["properties"]
    assert schema["additionalProperties"] is False
    assert schema["$defs"]["CameraSettings"]["properties"]["focal_mm"]["unit"] == "mm"
