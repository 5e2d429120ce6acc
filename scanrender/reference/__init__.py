"""Float64 truth that the renderer is judged against; it uses profiles, never filter kernels.

`truth_picture` is the picture of a prepared scan by two integrals over its whole surface;
`integrals` are these at any points; `gather` is the best that a picture alone allows; `analytic`
holds cases whose answer is known.
"""

from __future__ import annotations

from scanrender.reference.gather import gather, pixel_areas
from scanrender.reference.points import PictureCamera
from scanrender.reference.truth import (
    Convergence,
    TruthPicture,
    TruthQuality,
    integrals,
    truth_picture,
)

__all__ = [
    "Convergence",
    "PictureCamera",
    "TruthPicture",
    "TruthQuality",
    "gather",
    "integrals",
    "pixel_areas",
    "truth_picture",
]
