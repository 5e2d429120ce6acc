"""The view transform as a table: scene-linear Rec.709 in, sRGB display out, through OpenColorIO.

The config is a named built-in of the OpenColorIO inside OpenImageIO, so that `$OCIO` cannot change
a picture; its name goes into the manifest. The table is 3-D over log2 of scene-linear values, and a
test holds its error against OpenColorIO itself.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio  # noqa: N813

from scanrender.errors import StageError
from scanrender.settings.shot import ViewSettings

OCIO_CONFIG = "ocio://cg-config-v2.1.0_aces-v1.3_ocio-v2.3"
DISPLAY = "sRGB - Display"
VIEWS = {"filmic": "ACES 1.0 - SDR Video", "neutral": "Un-tone-mapped"}
SCENE_SPACE = "Linear Rec.709 (sRGB)"

TABLE_SIZE = 64
# 0.004 % of white to 64 times white; both ends are flat in every SDR view.
LOG2_RANGE = (-12.0, 6.0)


def apply_view(linear: npt.NDArray[np.float32], transform: str) -> npt.NDArray[np.float32]:
    """Scene-linear Rec.709 (h, w, 3) to display values by OpenColorIO itself, no table."""
    pixels: Any = np.ascontiguousarray(linear, dtype=np.float32)
    source = oiio.ImageBuf(pixels)
    shown = oiio.ImageBufAlgo.ociodisplay(
        source, DISPLAY, VIEWS[transform], SCENE_SPACE, "", False, colorconfig=OCIO_CONFIG
    )
    if shown.has_error:
        raise StageError(f"OpenColorIO cannot apply the view {transform!r}: {shown.geterror()}")
    return np.asarray(shown.get_pixels(oiio.FLOAT), dtype=np.float32).reshape(linear.shape)


@cache
def view_table(transform: str) -> npt.NDArray[np.float32]:
    """(blue, green, red, 3) display values over the log2 grid of `LOG2_RANGE`."""
    low, high = LOG2_RANGE
    grid = np.exp2(np.linspace(low, high, TABLE_SIZE)) - np.exp2(low)
    blue, green, red = np.meshgrid(grid, grid, grid, indexing="ij")
    rows = np.stack([red, green, blue], axis=-1).reshape(TABLE_SIZE, -1, 3)
    return apply_view(rows.astype(np.float32), transform).reshape((TABLE_SIZE,) * 3 + (3,))


def describe(view: ViewSettings) -> dict[str, str]:
    """What the manifest says about the view."""
    return {"ocio_config": OCIO_CONFIG, "display": DISPLAY, "view": VIEWS[view.transform]}
