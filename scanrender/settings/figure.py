"""`figure:` one shot several ways, side by side, with numbers: what the paper's figures are."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from scanrender.settings.base import Section, setting

NumberName = Literal[
    "black_pixels",
    "border_contrast",
    "delta_e",
    "energy_ratio",
    "high_frequency",
    "mean",
    "silhouette_leak",
]


Share = Annotated[float, Field(ge=0, le=1)]


class Panel(Section):
    """One picture of the figure."""

    label: str = setting(..., "What the panel shows, in a few words.", unit="")
    set: dict[str, Any] = setting(
        {}, "What differs from the pipeline, as with --set: `diffusion.halo: depth`.", unit=""
    )
    show: str = setting(
        "display", "The buffer shown; any but `display` in false colour with a legend.", unit=""
    )


class FigureSettings(Section):
    """Panels instead of a turntable; without panels there is no figure."""

    panels: tuple[Panel, ...] = setting((), "The pictures, in order.", unit="")
    columns: int = setting(3, "Panels in a row.", unit="1", ge=1, le=12)
    frame: int = setting(0, "The turntable's frame that is shown.", unit="1", ge=0, le=100_000)
    crop: tuple[Share, Share, Share, Share] = setting(
        (0.0, 0.0, 1.0, 1.0),
        "Left, top, right, bottom of the part that is shown, as shares of the picture.",
        unit="1",
    )
    numbers: tuple[NumberName, ...] = setting(
        ("black_pixels", "delta_e", "energy_ratio"),
        "What is measured on each panel, against the first one; figure.json holds it.",
        unit="",
    )
