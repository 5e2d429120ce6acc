"""A sphere of skin in hard light, with and without scattering: the Python API without a scan.

    python examples/render_sphere.py --out out/sphere

Writes plain.png and skin.png and says how far red, green and blue light reaches past the shadow's
edge. Everything a scan would bring is made with NumPy here, so this is also the shortest
description of what an asset is.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from scanrender.asset import Asset, Mesh
from scanrender.outputs.png import write_frame_png
from scanrender.render.device import device
from scanrender.render.frame import Renderer
from scanrender.settings.pipeline import Pipeline

RADIUS_MM = 12.0


def sphere(radius_mm: float, rings: int = 48) -> Asset:
    """A UV sphere of one colour. Angles: v from the north pole, u around +Y."""
    v, u = np.meshgrid(
        np.linspace(0.0, 1.0, rings + 1), np.linspace(0.0, 1.0, 2 * rings + 1), indexing="ij"
    )
    polar, around = np.pi * v.ravel(), 2.0 * np.pi * u.ravel()
    normals = np.stack(
        [np.sin(polar) * np.sin(around), np.cos(polar), np.sin(polar) * np.cos(around)], axis=1
    )
    tangents = np.stack(
        [np.cos(around), np.zeros_like(around), -np.sin(around), np.ones_like(around)], axis=1
    )
    corner = np.arange((rings + 1) * (2 * rings + 1)).reshape(v.shape)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    faces = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    mesh = Mesh(
        positions_mm=(radius_mm * normals).astype(np.float32),
        normals=normals.astype(np.float32),
        tangents=tangents.astype(np.float32),
        uv=np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float32),
        faces=faces.astype(np.uint32),
    )
    # Maps may have any size; those left out take a neutral value.
    skin_colour = np.full((1, 1, 3), (0.55, 0.34, 0.25), dtype=np.float32)
    return Asset(mesh, {"albedo": skin_colour})


def settings(method: str, size_px: int) -> Pipeline:
    """What a pipeline file would say. Values are checked like a file's."""
    return Pipeline.model_validate(
        {
            "diffusion": {"method": method},
            "skin": {"transmission": {"method": "none"}},
            "lights": [{"type": "directional", "azimuth_deg": 90, "elevation_deg": 0}],
            "camera": {"width_px": size_px, "height_px": size_px, "elevation_deg": 0},
        }
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/sphere"))
    parser.add_argument("--size", type=int, default=512, help="side of the picture in px")
    arguments = parser.parse_args()

    asset = sphere(RADIUS_MM)
    lit = {}
    for name, method in (("plain", "none"), ("skin", "gaussian_sum")):
        renderer = Renderer(device(), asset, settings(method, arguments.size))
        frame = renderer.render(renderer.view(0), ["diffuse", "position"])
        write_frame_png(arguments.out / f"{name}.png", frame)
        lit[name] = frame
    # Along the equator the light ends where x passes 0; what shines at x < 0 was scattered there.
    row = arguments.size // 2
    x_mm = lit["skin"].buffers["position"][row, :, 0]
    dark = (lit["skin"].alpha[row] > 0.5) & (x_mm < 0.0)
    for channel, colour in enumerate(("red", "green", "blue")):
        light = lit["skin"].buffers["diffuse"][row, :, channel]
        reach = (-x_mm[dark & (light > 0.001 * light.max())]).max(initial=0.0)
        print(f"{colour}: 0.1 % of the brightest light reaches {reach:.1f} mm past the edge")


if __name__ == "__main__":
    main()
