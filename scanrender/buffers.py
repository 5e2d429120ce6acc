"""The catalogue of buffers: their names are API, the same in Python, GLSL, EXR layers and docs.

A pass may only read and write buffers described here. `docs/buffers.md` is generated from this
table, and a test holds the two together.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from scanrender.errors import UsageError

Kind = Literal["colour", "vector", "scalar"]
SUFFIXES: Mapping[Kind, str] = {"colour": "RGB", "vector": "XYZ", "scalar": "Y"}


@dataclass(frozen=True)
class BufferSpec:
    """One buffer: what it holds, in which space and unit, and how a healthy one looks.

    `premultiplied` buffers are multiplied by their mask (alpha) on the device, and divided by it
    when they are dumped. `span` is the fixed range of the false-colour picture; None takes the 0.5 and 99.5 percentiles.
    `limits` are the values that it can hold at all: what lies outside is a fault (`--check`).
    """

    name: str
    kind: Kind
    space: str
    unit: str
    meaning: str
    healthy: str
    span: tuple[float, float] | None = None
    premultiplied: bool = False
    limits: tuple[float, float] = (-math.inf, math.inf)

    @property
    def channels(self) -> tuple[str, ...]:
        """EXR channel names: a letter first, one dot (Nuke, tev and Blender group by it)."""
        return tuple(f"{self.name}.{suffix}" for suffix in SUFFIXES[self.kind])


def _spec(
    name: str,
    kind: Kind,
    space: str,
    unit: str,
    meaning: str,
    healthy: str,
    span: tuple[float, float] | None = None,
) -> BufferSpec:
    masked = name in ("diffusion_input", "gaussian_0", "diffuse_horizontal", "scattered")
    limits = next(limits for limits, names in _LIMITS.items() if name in names)
    return BufferSpec(name, kind, space, unit, meaning, healthy, span, masked, limits)


_LIMITS: Mapping[tuple[float, float], Collection[str]] = {
    (0.0, 1.0): (
        "visibility_0", "albedo", "skin", "ao", "transmittance", "rejected", "nan_map", "display",
    ),
    (-1.0, 1.0): ("normal_geometry", "normal_shading"),
    # Corners of Rec.709 in Lab: L 0 to 100, a -86 to 98, b -108 to 95.
    (-110.0, 101.0): ("lab",),
    (-math.inf, math.inf): ("position", "shadow_0", "curvature_raw", "curvature"),
    # Light, lengths, areas, weights: as much as there is, but never less than nothing.
    (0.0, math.inf): (
        "depth_mm", "irradiance", "diffusion_input", "thickness_mm", "transmission", "jacobian",
        "edge_guide", "weight_sum", "kernel_px", "gaussian_0", "diffuse_horizontal", "scattered",
        "diffuse", "specular", "energy_ratio", "radiance", "beauty",
    ),
}
LINEAR = "lin_rec709_scene"

_SPECS = (
    _spec("shadow_0", "scalar", "light 0", "mm",
          "Distance of the first surface from light 0's near plane; N counts the lights.",
          "A smooth relief of the head as the light sees it; empty parts at the far value."),
    _spec("visibility_0", "scalar", "surface", "1",
          "Share of light 0 that reaches the surface past what casts shadows.",
          "A clean stencil of the lit side with a soft edge; no stripes.", (0.0, 1.0)),
    _spec("position", "vector", "view", "mm",
          "Surface position; the camera is at the origin and looks along -Z.",
          "Smooth gradients without steps inside the head."),
    _spec("normal_geometry", "vector", "view", "1",
          "Unit normal of the surface without the normal map.",
          "Large soft forms only: no pores.", (-1.0, 1.0)),
    _spec("normal_shading", "vector", "view", "1",
          "Unit normal with the normal map: what light and highlight use.",
          "The same forms with pores and wrinkles on top.", (-1.0, 1.0)),
    _spec("albedo", "colour", LINEAR, "1",
          "Diffuse reflectance from the atlas.",
          "Flat, unlit skin colour; no seams where charts meet."),
    _spec("skin", "scalar", "surface", "1",
          "Probability that the surface is skin; 0 where there is no surface.",
          "High on skin, low on eyes, brows and hair.", (0.0, 1.0)),
    _spec("ao", "scalar", "surface", "1",
          "Ambient visibility: the share of the sky that the surface sees.",
          "Bright on the forehead, dark in nostrils and behind the ears.", (0.0, 1.0)),
    _spec("depth_mm", "scalar", "view", "mm",
          "Distance along the view axis, -z; 0 where there is no surface.",
          "A smooth ramp; the nose nearest."),
    _spec("irradiance", "colour", LINEAR, "radiometric, 1 = a unit directional light at normal",
          "Light that arrives at the surface, without albedo, entry Fresnel included.",
          "A plaster cast under the same lights, with hard shadows."),
    _spec("diffusion_input", "colour", LINEAR, "as irradiance",
          "irradiance x albedo^m, what diffuses: m = 1, 1/2, 0 for texturing pre, mixed, post.",
          "The plaster cast, tinted by part of the albedo."),
    _spec("thickness_mm", "scalar", "light", "mm",
          "Length of skin between the surface and where light enters: along the light, or baked along the normal.",
          "Small only at ears, nostrils and lips; large in the middle of the face."),
    _spec("transmittance", "colour", LINEAR, "1",
          "T(d): the share of light that passes skin of that thickness, per channel.",
          "Red at the rims of the ears, black elsewhere.", (0.0, 1.0)),
    _spec("transmission", "colour", LINEAR, "as radiance",
          "Light that passes through thin skin from behind.",
          "Red glow in ears against the light, nothing on the lit side."),
    _spec("curvature_raw", "scalar", "view", "1/mm",
          "Mean curvature of the geometry normals from screen differences; convex positive.",
          "Noisy but centred; no bright line along silhouettes.", (-0.2, 0.2)),
    _spec("curvature", "scalar", "view", "1/mm",
          "Mean curvature, from the screen or baked, smoothed along the surface.",
          "Nose tip and lips positive, eye sockets and nose wings negative.", (-0.1, 0.1)),
    _spec("jacobian", "scalar", "screen", "1",
          "Skin area that a pixel shows, relative to a facing pixel at the working distance.",
          "1 in the middle of the face, rising smoothly toward silhouettes.", (0.0, 4.0)),
    _spec("edge_guide", "scalar", "screen", "1, or m² for halo: cbf",
          "What the cross bilateral filters compare: grey albedo x cosine of the ray to the view axis / cosine of the surface to the ray.",
          "The grey albedo in the middle of the face, bright along silhouettes; the same at any distance unless halo is cbf."),
    _spec("lab", "vector", "CIE Lab, D65", "L, a, b",
          "Colour of the albedo that limits scattering, smoothed on the surface with its edges kept.",
          "Flat patches without pores; borders of lips and brows as sharp as in the albedo."),
    _spec("weight_sum", "colour", "screen", "1",
          "Share of the kernel's weight that its taps keep past halo, limit and mask, per channel, mean of both directions.",
          "1 on smooth skin, lower along silhouettes and what is no skin.", (0.0, 1.0)),
    _spec("rejected", "scalar", "screen", "1",
          "Share of the taps that keep less than half of their weight.",
          "0 on smooth skin; a band along silhouettes as wide as the kernel.", (0.0, 1.0)),
    _spec("kernel_px", "colour", "screen", "px",
          "Radius that holds 99.9 % of the diffusion profile, per channel, on screen.",
          "Nearly constant over the face; red several times blue."),
    _spec("gaussian_0", "colour", LINEAR, "as irradiance",
          "diffusion_input blurred to variance k of the profile; N counts the Gaussians.",
          "Each level softer than the one before; the silhouette stays sharp."),
    _spec("diffuse_horizontal", "colour", LINEAR, "as irradiance",
          "The separable kernel, or the last Gaussian, after its horizontal pass only.",
          "Blurred along rows, sharp along columns."),
    _spec("scattered", "colour", LINEAR, "as irradiance",
          "diffusion_input after the whole diffusion, before the rest of the albedo.",
          "The plaster cast gone soft, with red past the edge of shadows."),
    _spec("diffuse", "colour", LINEAR, "as radiance",
          "Light that left the skin after scattering, after albedo.",
          "Soft skin with red past the edge of shadows; sharp brows and eyes."),
    _spec("specular", "colour", LINEAR, "as radiance",
          "Light reflected at the skin's surface; never blurred.",
          "Sharp, pore-broken highlights on forehead, nose and lips."),
    _spec("energy_ratio", "colour", "screen", "1",
          "Diffused over undiffused light, per channel.",
          "Near 1 on evenly lit skin, above 1 inside shadow edges.", (0.0, 2.0)),
    _spec("nan_map", "scalar", "screen", "1",
          "1 where the radiance is not a finite number or is negative.",
          "Black.", (0.0, 1.0)),
    _spec("radiance", "colour", LINEAR, "radiometric",
          "Sum of one sample: diffuse + transmission + specular.",
          "The finished picture without antialiasing."),
    _spec("beauty", "colour", LINEAR, "radiometric",
          "All samples resolved, cropped to the picture, scene-linear.",
          "The finished picture before the view transform."),
    _spec("display", "colour", "sRGB display", "1",
          "beauty after exposure and the view transform.",
          "The finished picture.", (0.0, 1.0)),
)

CATALOGUE: Mapping[str, BufferSpec] = {spec.name: spec for spec in _SPECS}
_NUMBERED = re.compile(r"^(shadow|visibility|gaussian)_\d+$")


def buffer_spec(name: str) -> BufferSpec:
    """The description of `name`; shadow_3 and gaussian_5 resolve to their family. UsageError."""
    if name in CATALOGUE:
        return CATALOGUE[name]
    if _NUMBERED.match(name):
        family = CATALOGUE[f"{name.rsplit('_', 1)[0]}_0"]
        return replace(family, name=name)
    raise UsageError(
        f"no buffer is called {name!r}", fix="scanrender render ASSET --buffers list shows them"
    )


@dataclass(frozen=True)
class Frame:
    """One rendered picture: named buffers, (h, w, channels) float32, top row first, cropped.

    `alpha` (h, w) float32 is the resolved coverage of the subject. `info` is plain JSON data
    (index, angle, camera, timings).
    """

    buffers: Mapping[str, npt.NDArray[np.float32]]
    alpha: npt.NDArray[np.float32]
    info: Mapping[str, Any] = field(default_factory=dict)
