"""`scan:` what the file itself does not say about the scan."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import PositiveFloat, model_validator

from scanrender.settings.base import Section, setting

Axis = Literal["+x", "-x", "+y", "-y", "+z", "-z"]


class ScanSettings(Section):
    """Units and orientation of the raw scan: stated here, or inferred with a reason."""

    units: Literal["auto", "mm", "cm", "m", "in"] | PositiveFloat = setting(
        "auto",
        "Unit of the scan's coordinates, or the number of millimetres in one of its units; "
        "`auto` infers it from the size of the subject and says why.",
        unit="word, or mm per unit",
    )
    height_mm: PositiveFloat | None = setting(
        None,
        "Height of the scan's bounding box along its up axis; use this or `units`, never both.",
        unit="mm",
    )
    up: Literal["auto"] | Axis = setting(
        "auto", "The scan's axis that points to the crown of the head.", unit=""
    )
    front: Literal["auto"] | Axis = setting(
        "auto", "The scan's axis that the face looks along.", unit=""
    )

    @model_validator(mode="after")
    def _units_or_height(self) -> Self:
        if self.height_mm is not None and self.units != "auto":
            raise ValueError("give either units or height_mm, not both")
        return self
