"""Numbers from words of text, in bulk, whatever the words are.

NumPy converts fastest from fixed-width bytes, which take the longest word's width for all of them:
one word of a megabyte among a million would ask for a terabyte. Long words go one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

_USUAL = 32  # bytes: a double with all its digits, sign and exponent has 24
_LONGEST = 1000  # an exact double in positional notation has at most 1,077, and nobody writes that


def floats(words: Sequence[bytes]) -> npt.NDArray[np.float64]:
    """(n,) float64. Raises ValueError when a word is not a number."""
    return np.asarray(_converted(words, np.float64, float))


def integers(words: Sequence[bytes]) -> npt.NDArray[np.int64]:
    """(n,) int64. Raises ValueError when a word is not a whole number, or not of that range."""
    try:
        return np.asarray(_converted(words, np.int64, int))
    except OverflowError as error:
        raise ValueError(str(error)) from error


def _converted(words: Sequence[bytes], dtype: Any, one: Callable[[bytes], Any]) -> npt.NDArray[Any]:
    longest = max(map(len, words), default=0)
    if longest <= _USUAL:
        return np.array(words, dtype="S").astype(dtype)
    if longest > _LONGEST:
        raise ValueError(f"a word of {longest} letters is no number")
    return np.array([one(word) for word in words], dtype)
