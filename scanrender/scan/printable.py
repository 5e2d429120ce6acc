"""Names that a scan's files hold, as sentences may show them."""

from __future__ import annotations

_LONGEST = 120


def printable(name: object) -> str:
    """One line of at most 120 characters, control characters and half surrogates escaped."""
    text = str(name)
    shown = "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode("ascii")
        for letter in text[:_LONGEST]
    )
    return shown if len(text) <= _LONGEST >= len(shown) else f"{shown[: _LONGEST - 3]}..."
