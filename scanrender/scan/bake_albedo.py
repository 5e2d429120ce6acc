"""Albedo from the raw scan's pages or vertex colours, supersampled in linear light."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.pages import Page
from scanrender.scan.project import Projector, Samples
from scanrender.scan.rasterize import rasterize
from scanrender.scan.raw import NO_PAGE
from scanrender.scan.rays import Hits
from scanrender.scan.surface import Surface
from scanrender.scan.topology import face_areas, face_centres

Array = npt.NDArray[Any]


class ColorSource:
    """What colour the raw surface has at a hit. Faces without colour borrow the nearest one's."""

    def __init__(
        self, surface: Surface, pages: tuple[Page, ...], default: tuple[float, ...]
    ) -> None:
        self.surface, self.pages, self.default = surface, pages, np.asarray(default, np.float32)
        textured = surface.page != NO_PAGE
        if surface.corner_uv is not None:
            textured &= np.isfinite(surface.corner_uv).all(axis=(1, 2))
        self.kind = "none"
        if pages and textured.any() and surface.corner_uv is not None:
            self.kind = "texture"
        elif surface.colors is not None:
            self.kind = "vertex"
        self.substitute = _substitutes(surface, textured) if self.kind == "texture" else None

    def pixels_mm(self) -> tuple[float, list[float]]:
        """Median size on the surface of a pixel, by area: of all pages together, and of each;
        infinite where nothing says how large one is."""
        surface, count = self.surface, len(self.pages)
        if self.kind != "texture" or surface.corner_uv is None:
            return float("inf"), [float("inf")] * count
        size = np.array([page.size for page in self.pages], np.float64)
        used = np.flatnonzero((surface.page != NO_PAGE) & (size[surface.page].min(axis=1) > 1))
        uv = surface.corner_uv[used] * size[surface.page[used]][:, None]
        e1, e2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
        pixels = 0.5 * np.abs(e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0])
        area = face_areas(surface.positions, surface.faces[used])
        valid = np.isfinite(pixels) & (pixels > 1e-9) & (area > 0.0)
        page, area = surface.page[used][valid], area[valid]
        side = np.sqrt(area / pixels[valid])
        each = [_median(side[page == k], area[page == k]) for k in range(count)]
        return _median(side, area), each

    def shrunk(self, factors: Sequence[int]) -> ColorSource:
        """The same source with each page averaged over factor x factor pixels."""
        if max(factors, default=1) <= 1:
            return self
        smaller = copy(self)
        smaller.pages = tuple(
            page.shrunk(factor) for page, factor in zip(self.pages, factors, strict=True)
        )
        return smaller

    def at(self, hits: Hits) -> npt.NDArray[np.float32]:
        """Linear Rec.709 (k, 3)."""
        surface = self.surface
        if self.kind == "none":
            return np.broadcast_to(self.default, (len(hits.face), 3)).astype(np.float32)
        if self.kind == "vertex":
            assert surface.colors is not None
            corners = np.take(surface.colors, surface.faces[hits.face], axis=0)
            return np.asarray(np.einsum("kc,kcd->kd", hits.bary, corners), np.float32)
        assert surface.corner_uv is not None
        assert self.substitute is not None
        face = self.substitute[hits.face]
        borrowed = face != hits.face
        bary = np.where(borrowed[:, None], np.float32(1 / 3), hits.bary)
        uv = np.einsum("kc,kcd->kd", bary, surface.corner_uv[face])
        page = surface.page[face]
        out = np.empty((len(face), 3), np.float32)
        for number in np.unique(page):
            chosen = page == number
            out[chosen] = self.pages[number].sample(uv[chosen])
        return out


def bake_albedo(source: ColorSource, samples: Samples) -> npt.NDArray[np.float32]:
    """Linear colours (k, 3) at the texels of `samples`: one sample each."""
    return samples.bake([((3,), np.float32)], lambda _, hits: [source.at(hits)])[0]


def bake_albedo_supersampled(
    projector: Projector, source: ColorSource, size: int, supersample: int
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_], float]:
    """(size, size, 3) linear, the covered texels (size, size), and the share of nearest points."""
    mesh = projector.mesh
    total = np.zeros((size * size, 3), np.float32)
    weight = np.zeros(size * size, np.float32)
    missed = count = 0.0
    # One pass for each place inside the texels, so that memory is that of one sample.
    for place in np.ndindex(supersample, supersample):
        shift = (np.array(place) + 0.5) / supersample - 0.5
        texels = rasterize(mesh.uv - shift / size, mesh.faces, size)
        samples = Samples(texels, *projector.project(texels))
        total[texels.index] += bake_albedo(source, samples)
        weight[texels.index] += 1.0
        missed += samples.missed * len(texels.index)
        count += len(texels.index)
    total /= np.maximum(weight, 1.0)[:, None]
    covered = (weight > 0).reshape(size, size)
    return total.reshape(size, size, 3), covered, missed / max(1.0, count)


def supersampling(source_mm: float, texel_mm: float) -> int:
    """Samples along each side of a texel, from an image of source_mm a pixel: one suffices where
    the image is no finer than the map; where it is much finer, it is averaged first."""
    return 1 if texel_mm / source_mm < 1.2 else 2


def averaging(page_mm: Sequence[float], sample_mm: float) -> list[int]:
    """For each page of page_mm a pixel, how many along a side make up a sample: averaged over
    those, samples that lie sample_mm apart still see all of it."""
    return [max(1, int(sample_mm / pixel_mm)) for pixel_mm in page_mm]


def _median(values: Array, weights: Array) -> float:
    """By weight; infinite of nothing."""
    if not len(values):
        return float("inf")
    order = np.argsort(values)
    passed = np.cumsum(weights[order])
    return float(values[order[int(np.searchsorted(passed, 0.5 * passed[-1]))]])


def _substitutes(surface: Surface, textured: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
    """For each face itself if it is textured, else the textured face with the nearest centre."""
    substitute = np.arange(len(surface.faces))
    if not textured.all():
        from scipy.spatial import cKDTree

        centre = face_centres(surface.positions, surface.faces)
        candidates = np.flatnonzero(textured)
        _, nearest = cKDTree(centre[candidates]).query(centre[~textured])
        substitute[~textured] = candidates[nearest]
    return substitute
