"""`quality.check`: what each pass has written is looked at, and the first that is wrong is named.

A value that is not finite, or that its buffer cannot hold (`BufferSpec.limits`), is found in the
pass that made it, before filters spread it over the picture. The guard band counts too: its light
scatters into the picture.
"""

from __future__ import annotations

from collections.abc import Sequence

import moderngl
import numpy as np
import numpy.typing as npt

from scanrender.buffers import buffer_spec
from scanrender.errors import StageError
from scanrender.render.graph import Pass
from scanrender.render.scene import Shot

# What rounding may take a value past its limits, as a share of their span: a half float's step.
SLACK = 1e-3
_DTYPES = {"f2": np.float16, "f4": np.float32}
_CHANNELS = "RGBA"


def check_pass(step: Pass, shot: Shot, textures: Sequence[moderngl.Texture]) -> None:
    """Look at everything that `step` has written. Raises StageError that names the first fault."""
    for buffer, texture in zip(step.writes, textures, strict=True):
        is_private = buffer.name.startswith("_")
        limits = (-np.inf, np.inf) if is_private else buffer_spec(buffer.name).limits
        pixels = pixels_of(texture)
        if (bad := faults(pixels, limits)).any():
            guard = 0 if buffer.size else shot.guard_px
            raise _error(step, buffer.name, shot.sample, pixels, bad, guard)


def pixels_of(texture: moderngl.Texture) -> npt.NDArray[np.floating]:
    """(h, w, components) of the whole texture, top row first."""
    raw = np.frombuffer(texture.read(alignment=1), _DTYPES[texture.dtype])
    return raw.reshape(texture.height, texture.width, texture.components)[::-1]


def faults(pixels: npt.NDArray[np.floating], limits: tuple[float, float]) -> npt.NDArray[np.bool_]:
    """(h, w, components): not finite, or further outside `limits` than rounding takes it.

    A fourth channel is coverage or a mask: it must not be negative.
    """
    low, high = limits
    slack = SLACK * (high - low) if np.isfinite(high - low) else 0.0
    bad = ~np.isfinite(pixels)
    colour = pixels[:, :, :3]
    bad[:, :, :3] |= (colour < low - slack) | (colour > high + slack)
    bad[:, :, 3:] |= pixels[:, :, 3:] < 0.0
    return np.asarray(bad)


def check_beauty(beauty: npt.NDArray[np.float32]) -> None:
    """The picture (h, w, 4) itself: always looked at. Raises StageError for what is no light."""
    # In float64 no picture's sum overflows: it is finite when each pixel is.
    with np.errstate(invalid="ignore"):
        total = beauty.sum(dtype=np.float64)
    if np.isfinite(total) and beauty.min() >= 0.0:
        return
    bad = ~(np.isfinite(beauty) & (beauty >= 0.0))
    (y, x), value = _first(beauty, bad)
    what = "non-finite" if not np.isfinite(beauty).all() else "negative"
    raise StageError(
        f"{_count(bad, what)} in beauty",
        where=f"first at column {x}, row {y} ({value})",
        fix="render it again with --check, which names the pass that made them",
    )


def _error(
    step: Pass,
    name: str,
    sample: int,
    pixels: npt.NDArray[np.floating],
    bad: npt.NDArray[np.bool_],
    guard_px: int,
) -> StageError:
    (y, x), value = _first(pixels, bad)
    what = "non-finite" if not np.isfinite(pixels[bad]).all() else "out-of-range"
    height, width = (side - 2 * guard_px for side in pixels.shape[:2])
    column, row = x - guard_px, y - guard_px
    outside = "" if 0 <= column < width and 0 <= row < height else ", in the guard band"
    reads = f"it reads {', '.join(step.reads)}, which are sound" if step.reads else "it reads none"
    return StageError(
        f"pass {step.name} wrote {_count(bad, what)} into {name}",
        where=f"sample {sample}, first at column {column}, row {row}{outside} ({value})",
        fix=f"{reads}: change this pass's settings, or report it with this pipeline and scan",
    )


def _count(bad: npt.NDArray[np.bool_], what: str) -> str:
    count = int(bad.any(axis=2).sum())
    return f"{count} {what} pixel{'' if count == 1 else 's'}"


def _first(
    pixels: npt.NDArray[np.floating], bad: npt.NDArray[np.bool_]
) -> tuple[tuple[int, int], str]:
    """(row, column) of the first offender from the top, and its channel and value."""
    y, x, channel = (int(i) for i in np.argwhere(bad)[0])
    return (y, x), f"{_CHANNELS[channel]} = {float(pixels[y, x, channel]):g}"
