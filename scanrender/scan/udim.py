"""UDIM: one material whose image comes in tiles, told by the whole part of the coordinates.

Tile 1001 + u + 10 v holds [u, u + 1) x [v, v + 1) with v upward, u from 0 to 9 (Foundry's Mari).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.pages import Page, read_page
from scanrender.scan.raw import NO_PAGE
from scanrender.scan.read_mtl import Paged, tile_name
from scanrender.scan.safe_path import Listings, inside

_LAST = 1999
Array = npt.NDArray[Any]


def unfold_tiles(
    paged: Paged, page: Array, corner_uv: Array, path: Path, notes: list[str]
) -> tuple[Paged, npt.NDArray[np.int16], npt.NDArray[np.float32]]:
    """A page for each tile that is there, and coordinates within it.

    page (m,) of triangles and corner_uv (m, 3, 2), origin top left, as read. Faces in a tile that
    is missing keep the first one, repeated, when the material names that one file alone.
    """
    pages, normals = list(paged.pages), list(paged.normals)
    page, corner_uv = page.copy(), corner_uv.copy()
    middle = corner_uv.mean(axis=1)
    known = np.isfinite(middle).all(axis=1)
    column = np.floor(np.where(known, middle[:, 0], 0.0))
    row = np.floor(np.where(known, 1.0 - middle[:, 1], 0.0))
    valid = (column >= 0) & (column < 10) & (row >= 0) & (1001 + 10 * row <= _LAST)
    number = np.where(valid, 1001 + column + 10 * row, 0).astype(np.int64)
    listings: Listings = {}
    for first, (pattern, normal_pattern, folder) in paged.tiled.items():
        for tile in np.unique(number[page == first]):
            if tile in (0, 1001):
                continue
            chosen = (page == first) & (number == tile)
            image = _tile(path, pattern, int(tile), "srgb", folder, listings)
            if image is None:
                notes.append(f"the tile {tile_name(pattern, int(tile))} is missing")
                if paged.pages[first].name != tile_name(pattern, 1001):
                    page[chosen] = NO_PAGE
                continue
            page[chosen] = len(pages)
            pages.append(image)
            normals.append(
                _tile(path, normal_pattern, int(tile), "linear", folder, listings)
                if normal_pattern
                else None
            )
            corner_uv[chosen, :, 0] -= (tile - 1001) % 10
            corner_uv[chosen, :, 1] += (tile - 1001) // 10
    return Paged(tuple(pages), tuple(normals), page, paged.tiled), page, corner_uv


def _tile(
    path: Path, pattern: str, number: int, encoding: Any, folder: str, listings: Listings
) -> Page | None:
    file = inside(path.parent, tile_name(pattern, number), path, folder, listings)
    return None if file is None else read_page(file, encoding)
