"""The whole of what a pipeline file may say."""

from __future__ import annotations

from typing import Any, Literal

from scanrender.settings.base import Section, setting
from scanrender.settings.figure import FigureSettings
from scanrender.settings.light import AmbientLight, DirectionalLight, Light
from scanrender.settings.outputs import OutputSettings
from scanrender.settings.prep import PrepSettings
from scanrender.settings.scan import ScanSettings
from scanrender.settings.shot import (
    CameraSettings,
    QualitySettings,
    TurntableSettings,
    ViewSettings,
)
from scanrender.settings.skin import CurvatureSettings, DiffusionSettings, SkinSettings

DEFAULT_LIGHTS: tuple[Light, ...] = (DirectionalLight(irradiance=2.0), AmbientLight())


class Pipeline(Section):
    """A recipe: from a raw scan to pictures. Every section and field has a default."""

    version: Literal[1] = setting(1, "Version of this file's format.", unit="")
    description: str = setting("", "One sentence for people.", unit="")
    stages: tuple[Literal["prep", "render"], ...] = setting(
        ("prep", "render"), "What is done; prep alone stops at the asset.", unit=""
    )
    scan: ScanSettings = ScanSettings()
    prep: PrepSettings = PrepSettings()
    skin: SkinSettings = SkinSettings()
    diffusion: DiffusionSettings = DiffusionSettings()
    curvature: CurvatureSettings = CurvatureSettings()
    lights: tuple[Light, ...] = setting(
        DEFAULT_LIGHTS, "The light rig; a list in a file replaces the inherited one whole.", unit=""
    )
    camera: CameraSettings = CameraSettings()
    turntable: TurntableSettings = TurntableSettings()
    quality: QualitySettings = QualitySettings()
    view: ViewSettings = ViewSettings()
    outputs: OutputSettings = OutputSettings()
    figure: FigureSettings = FigureSettings()
    matrix: dict[str, dict[str, dict[str, Any]]] = setting(
        {},
        "Named axes of named changes; every combination is run, in a folder of its own. A change "
        "holds sections, keys as with --set (`lights.0.irradiance: 0.5`), or `extends: a preset`.",
        unit="",
    )
