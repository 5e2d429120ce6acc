"""`figure:` one shot several ways, side by side, with numbers: what the paper's figures are."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from scanrender.settings.base import Section, setting

NumberName = Literal[
    "black_pixels",
    "border_contrast",
    "delta_e",
    "energy_ratio",
    "high_frequency",
    "mean",
    "silhouette_leak",
    "transmitted",
]

Share = Annotated[float, Field(ge=0, le=1)]
Value = Annotated[float, Field(ge=-1e9, le=1e9)]
Window = tuple[Share, Share, Share, Share]


class Panel(Section):
    """One picture of the figure."""

    label: str = setting(..., "What the panel shows, in a few words.", unit="")
    set: dict[str, Any] = setting(
        {}, "What differs from the pipeline, as with --set: `diffusion.halo: depth`.", unit=""
    )
    show: str = setting(
        "display",
        "The buffer shown; any but `display` in false colour with a legend. Panels that show the "
        "same one share its range.",
        unit="",
    )
    range: tuple[Value, Value] | None = setting(
        None, "Range of the false colour instead of the shared one.", unit="the buffer's"
    )
    difference: float = setting(
        0.0,
        "Shows the difference between this picture and the first panel's, times this; 0 shows the "
        "picture itself.",
        unit="1",
        ge=0,
        le=1000,
    )
    crop: Window | None = setting(None, "This panel's own part, instead of the figure's.", unit="1")

    @model_validator(mode="after")
    def _shows_something(self) -> Self:
        if self.difference and self.show != "display":
            raise ValueError("difference compares pictures: leave show at display")
        if self.range is not None and not self.range[0] < self.range[1]:
            raise ValueError("range runs from the smaller value to the larger one")
        _check_window(self.crop)
        return self


class FigureSettings(Section):
    """Panels instead of a turntable; without panels there is no figure."""

    title: str = setting("", "What it is called; the scan's name follows.", unit="")
    panels: tuple[Panel, ...] = setting((), "The pictures, in order.", unit="")
    columns: int = setting(3, "Panels in a row.", unit="1", ge=1, le=12)
    frame: int = setting(0, "The turntable's frame that is shown.", unit="1", ge=0, le=100_000)
    crop: Window = setting(
        (0.0, 0.0, 1.0, 1.0),
        "Left, top, right, bottom of the part that is rendered, as shares of the picture.",
        unit="1",
    )
    numbers: tuple[NumberName, ...] = setting(
        ("black_pixels", "delta_e", "energy_ratio"),
        "What is measured on what each panel shows, some against the first one: written under it "
        "and into figure.json.",
        unit="",
    )

    @model_validator(mode="after")
    def _crop_is_a_window(self) -> Self:
        _check_window(self.crop)
        return self


def _check_window(crop: Window | None) -> None:
    if crop is not None and not (crop[0] < crop[2] and crop[1] < crop[3]):
        raise ValueError("crop is left, top, right, bottom: left < right and top < bottom")
