"""Puts a small picture of each buffer into docs: `python tools/buffer_pictures.py OUT`.

OUT is what this wrote, on our own head or on any other that may be shown:

    scanrender run buffers ASSET --out OUT --set camera.width_px=400 --set camera.height_px=400 \
        --set camera.aim=head --set camera.height_mm=252.2
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

from scanrender.buffers import CATALOGUE

PICTURES = Path(__file__).resolve().parents[1] / "docs" / "images" / "buffers"
SIDE_PX = 200
QUALITY = 82


def main(out: Path) -> None:
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name in CATALOGUE:
        with Image.open(out / "buffers" / "frame_0000" / f"{name}.png") as picture:
            # The legend below is too small to read at this size; the page states the range.
            square = picture.convert("RGB").crop((0, 0, picture.width, picture.width))
            small = square.resize((SIDE_PX, SIDE_PX), Image.Resampling.LANCZOS)
        small.save(PICTURES / f"{name}.jpg", quality=QUALITY, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
