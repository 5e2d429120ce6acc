"""Which cases to measure: names separated by commas, or all."""

from __future__ import annotations

from collections.abc import Iterable

from scanrender.errors import UsageError


def chosen(text: str, known: Iterable[str]) -> list[str]:
    """The names in `text`, or all that are known. Raises UsageError for one that is not."""
    names = list(known)
    asked = names if text == "all" else [name.strip() for name in text.split(",") if name.strip()]
    for name in asked:
        if name not in names:
            raise UsageError(f"no such case: {name!r}", fix=f"one of {', '.join(names)}, or all")
    return asked
