"""A user's skin mask (`prep.skin.mask`): images in the raw scan's UVs, white where there is skin.

They are sampled as the scan's own texture pages are, one image a page, and replace the guess of
`skinmap`. As everything a scan names, they must lie in the scan's folder.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from scanrender.errors import ConfigError, ScanError
from scanrender.scan.bake_albedo import ColorSource, averaging
from scanrender.scan.pages import Page, read_page
from scanrender.scan.raw import NO_PAGE, RawMesh
from scanrender.scan.rays import Hits
from scanrender.scan.safe_path import inside
from scanrender.scan.surface import Surface

KEY = "prep.skin.mask"


@dataclass(frozen=True)
class SkinMask:
    """The mask's images in the order of the scan's texture pages; a scan without pages has one."""

    pages: tuple[Page, ...]

    def at(self, surface: Surface, hits: Hits, texel_mm: float) -> npt.NDArray[np.float32]:
        """Probability of skin (k,) in [0, 1] at hits on the cleaned raw surface, for a map of
        texel_mm: finer images are averaged first."""
        if surface.corner_uv is not None and not (surface.page != NO_PAGE).any():
            has_uv = np.isfinite(surface.corner_uv).all(axis=(1, 2))
            surface = replace(surface, page=np.where(has_uv, 0, NO_PAGE).astype(np.int16))
        source = ColorSource(surface, self.pages, (1.0, 1.0, 1.0))
        _, page_mm = source.pixels_mm()
        source = source.shrunk(averaging(page_mm, texel_mm))
        return np.asarray(np.clip(source.at(hits).mean(axis=1), 0.0, 1.0), np.float32)


def read_skin_mask(path: Path, raw: RawMesh, names: str | tuple[str, ...]) -> SkinMask:
    """The images `names`, relative to the folder of the scan at `path`.

    Raises ConfigError when one is missing or outside, or does not suit the scan; ScanError when
    one is no image.
    """
    wanted = (names,) if isinstance(names, str) else names
    if raw.corner_uv is None or not np.isfinite(raw.corner_uv).all(axis=(1, 2)).any():
        raise ConfigError(
            f"a skin mask needs texture coordinates, and {path.name} has none",
            KEY,
            "leave the mask out, or export the scan with texture coordinates",
        )
    if len(wanted) != max(1, len(raw.pages)):
        pages = ", ".join(page.name for page in raw.pages)[:300]
        count = len(raw.pages)
        held = f"{count} texture page{'s' * (count > 1)} ({pages})" if count else "no texture page"
        raise ConfigError(
            f"{path.name} has {held}, and the skin mask {_images(len(wanted))}",
            KEY,
            f"name {_images(max(1, len(raw.pages)))}, in the order of the pages",
        )
    return SkinMask(tuple(_page(path.parent, name) for name in wanted))


def _page(folder: Path, name: str) -> Page:
    try:
        file = inside(folder, name, Path(KEY))
    except ScanError as error:
        raise ConfigError(error.what, KEY, error.fix) from error
    if file is None:
        raise ConfigError(
            f"the skin mask {name} is missing",
            f"{KEY}, in {folder}",
            "name an image relative to the folder of the scan",
        )
    return read_page(file, "linear", f"the skin mask {name}")


def _images(count: int) -> str:
    return f"{count} image" + ("s" if count != 1 else "")
