"""The JSON Schema of pipeline files, made from the models; `configs/schema/` holds a copy."""

from __future__ import annotations

from typing import Any

from scanrender.settings.pipeline import Pipeline


def pipeline_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of one pipeline or preset file."""
    schema = Pipeline.model_json_schema()
    names = {"type": "array", "items": {"type": "string"}}
    schema["properties"]["extends"] = {
        "description": "Files or shipped presets that this file starts from, the later over the "
        "earlier: `light/portrait`, or a path beside this file.",
        "anyOf": [{"type": "string"}, names],
    }
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}
