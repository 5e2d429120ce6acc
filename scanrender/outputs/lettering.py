"""Words on pictures: Pillow's built-in typeface, measured, wrapped and shortened.

The typeface (Aileron, shipped inside Pillow) needs no font on the machine, so a picture made in a
container equals one made on a desk. It draws little beyond ASCII, hence `drawable`. Letters are set
four times as large and reduced: at 12 px, whole-pixel advances would close the gaps between words.
"""

from __future__ import annotations

import unicodedata
from functools import cache

from PIL import Image, ImageDraw, ImageFont

from scanrender.errors import OutputError

Colour = tuple[int, int, int]
Point = tuple[int, int]

OVERSAMPLE = 4

# What Aileron, as cut down for Pillow, draws beyond ASCII; all else would show as an empty box.
_EXTRA_GLYPHS = frozenset("©«°±´·»‘’“”…‹›™")
_SPELLED = str.maketrans(
    {"—": "-", "–": "-", "−": "-", "×": "x", "µ": "u", "σ": "sigma", "ß": "ss", "ø": "o", "Ø": "O",
     "æ": "ae", "Æ": "AE", "œ": "oe", "ł": "l", "Ł": "L", "đ": "d", "ð": "d", "þ": "th"}
)  # fmt: skip


def write(
    sheet: Image.Image, at: Point, words: str, colour: Colour, size: int, anchor: str = "l"
) -> None:
    """Write one line on RGB `sheet`; `at` (x, y) px is the left, middle or right of its top.

    `size` is the em in px, and a line takes about 1.2 of it; `anchor` is "l", "m" or "r".
    """
    words = drawable(words)
    width = round(measure(words, size) + 1.0)
    x = at[0] - {"l": 0, "m": width // 2, "r": width}[anchor]
    face = _face(size * OVERSAMPLE)
    large = Image.new("L", (width * OVERSAMPLE, round(size * 1.3) * OVERSAMPLE))
    ImageDraw.Draw(large).text((0, 0), words, 255, face)
    mask = large.reduce(OVERSAMPLE)
    sheet.paste(colour, (x, at[1]), mask)


def measure(text: str, size: int) -> float:
    """Width of `text` in px at `size`."""
    return _face(size * OVERSAMPLE).getlength(drawable(text)) / OVERSAMPLE


@cache
def _face(size: int) -> ImageFont.FreeTypeFont:
    loaded = ImageFont.load_default(size)
    if not isinstance(loaded, ImageFont.FreeTypeFont):
        raise OutputError(
            "this Pillow was built without FreeType and cannot draw text",
            fix="install Pillow from PyPI, whose wheels carry FreeType",
        )
    return loaded


def drawable(text: str) -> str:
    """`text` with what the typeface lacks spelled otherwise: Jörg -> Jorg, 2×2 -> 2x2, 李 -> ?."""
    letters = []
    for letter in unicodedata.normalize("NFC", text).translate(_SPELLED):
        if letter in _EXTRA_GLYPHS or " " <= letter <= "~":
            letters.append(letter)
            continue
        plain = unicodedata.normalize("NFKD", letter).encode("ascii", "ignore").decode()
        letters.append(plain if plain.isprintable() and plain else " " if letter.isspace() else "?")
    return "".join(letters)


def wrapped(text: str, size: int, width: float) -> list[str]:
    """`text` broken at spaces into lines of at most `width` px; a longer word stays whole."""
    lines: list[str] = []
    for word in text.split(" "):
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and measure(longer, size) <= width:
            lines[-1] = longer
        elif word:
            lines.append(word)
    return lines


def elided(text: str, size: int, width: float) -> str:
    """`text`, or as much of its beginning as fits `width` px with an ellipsis after it."""
    if measure(text, size) <= width:
        return text
    while text and measure(text + "…", size) > width:
        text = text[:-1].rstrip()
    return text + "…"
