"""Where inside a pixel the supersamples lie: deterministic, the same for every pixel and frame."""

from __future__ import annotations

import numpy as np


def sample_offsets_px(side: int) -> list[tuple[float, float]]:
    """`side`^2 offsets (right, down) from the pixel's centre, in (-0.5, 0.5).

    A Hammersley set: right is the point's number, down its digits read backwards, with the prime
    factors of `side` as radices, so that boxes of every shape that these allow hold equally many
    points (side 8: 1 x 64, 2 x 32, ... 64 x 1). A mere grid of sheared rows has that for three
    shapes only, and misjudges texels that are a pixel wide and a tenth of one high (decision 32).

    Half of the digits are turned (d to radix - 1 - d). With none turned the points lie along a
    diagonal (four of them with a correlation of 0.8): edges along it are sampled as by two, and a
    mirrored scene has another picture. The mean is the centre; one sample is the centre.
    """
    radices = 2 * _prime_factors(side)
    rest, count = np.arange(side * side), side * side
    right, down, weight = np.zeros(count), np.zeros(count), 1
    for place, radix in enumerate(radices):
        rest, digit = np.divmod(rest, radix)
        right += weight * digit
        weight *= radix
        turned = place >= len(radices) // 2
        down += count // weight * (radix - 1 - digit if turned else digit)
    return [(float(x), float(y)) for x, y in (np.stack([right, down], 1) + 0.5) / count - 0.5]


def _prime_factors(number: int) -> list[int]:
    """Smallest first; none of 1."""
    for divisor in range(2, number + 1):
        if number % divisor == 0:
            return [divisor, *_prime_factors(number // divisor)]
    return []
