"""What every settings section shares: unknown keys are refused, values are plain and frozen.

Each field carries its unit, its range and one sentence: the JSON Schema, `docs/settings.md` and
the editor's completion are made from them.
"""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field


class Section(BaseModel):
    """One section of a YAML file."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
    )


def setting(
    default: Any, sentence: str, *, unit: str, ge: float | None = None, le: float | None = None
) -> Any:
    """A documented field. `unit` is "1" for a plain number and "" where the value is a word."""
    extra: Any = {"unit": unit} if unit else None
    return Field(default, description=sentence, ge=ge, le=le, json_schema_extra=extra)


Vector3 = tuple[float, float, float]
Rgb = tuple[
    Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]
]
