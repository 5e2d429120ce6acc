"""Tangent-space and geometry normals from the raw scan, with the scan's own normal map applied."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.asset import Mesh
from scanrender.scan.pages import Page
from scanrender.scan.project import Samples
from scanrender.scan.rasterize import Texels
from scanrender.scan.raw import NO_PAGE
from scanrender.scan.rays import Hits
from scanrender.scan.surface import Surface
from scanrender.scan.tangents import corner_tangents, from_tangent_space, to_tangent_space
from scanrender.scan.topology import unit

Array = npt.NDArray[Any]

# Past this distance from the raw surface (a filled hole) the raw normal says nothing here.
FOREIGN_MM = 2.0


class NormalSource:
    """Object-space normals of the raw surface at a hit: smooth, and with its own normal map."""

    def __init__(
        self, surface: Surface, vertex_normals: Array, normal_pages: tuple[Page | None, ...]
    ) -> None:
        self.surface, self.normals = surface, vertex_normals.astype(np.float32)
        self.pages = normal_pages
        self.tangents: Array | None = None
        if surface.corner_uv is not None and any(page is not None for page in normal_pages):
            self.tangents = corner_tangents(
                surface.positions, surface.faces, vertex_normals, surface.corner_uv
            ).astype(np.float32)

    def smooth(self, hits: Hits) -> Array:
        corners = np.take(self.normals, self.surface.faces[hits.face], axis=0)
        return unit(np.einsum("kc,kcd->kd", hits.bary, corners), fallback=(0.0, 0.0, 1.0))

    def detailed(self, hits: Hits, smooth: Array) -> Array:
        """`smooth` bent by the scan's normal map where it has one."""
        if self.tangents is None or self.surface.corner_uv is None:
            return smooth
        normal = smooth.copy()
        page = self.surface.page[hits.face]
        for number, image in enumerate(self.pages):
            chosen = np.flatnonzero(page == number)
            if image is None or not len(chosen):
                continue
            face, bary = hits.face[chosen], hits.bary[chosen]
            uv = np.einsum("kc,kcd->kd", bary, self.surface.corner_uv[face])
            tangent = np.einsum("kc,kcd->kd", bary, self.tangents[face])
            local = image.sample(uv) * 2.0 - 1.0
            if image.flip_green:
                local[:, 1] *= -1.0
            known = np.isfinite(uv).all(axis=1) & (page[chosen] != NO_PAGE)
            bent = from_tangent_space(local, normal[chosen], tangent)
            normal[chosen] = np.where(known[:, None], bent, normal[chosen])
        return normal


def bake_normals(
    mesh: Mesh, source: NormalSource, samples: Samples
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Tangent-space normals (k, 3) at the texels, and the angles (k,) in degrees between the
    prepared and the raw surface there."""
    table = np.concatenate([mesh.normals, mesh.tangents], axis=1)[mesh.faces]

    def work(texels: Texels, hits: Hits) -> tuple[Array, Array]:
        frame = texels.interpolate(table)
        normal, tangent = frame[:, :3], frame[:, 3:]
        own = unit(normal, fallback=(0.0, 0.0, 1.0))
        smooth = source.smooth(hits)
        raw = source.detailed(hits, smooth)
        raw = np.where((hits.distance > FOREIGN_MM)[:, None], own, raw)
        cosine = np.einsum("ij,ij->i", smooth, own)
        local = to_tangent_space(raw, normal, tangent)
        # A normal below the horizon cannot be stored usefully: lean it back to grazing.
        local[:, 2] = np.maximum(local[:, 2], 0.02)
        return unit(local), np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))

    local, angle = samples.bake([((3,), np.float32), ((), np.float32)], work)
    return local, angle
