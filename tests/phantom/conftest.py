"""One small head and one damaged scan of it, made once for the whole folder."""

from __future__ import annotations

import pytest

from scanrender.phantom import Damage, Head, RawScan, make_head, scan_head

TRIANGLES = 50_000


@pytest.fixture(scope="session")
def head() -> Head:
    return make_head(TRIANGLES, seed=0)


@pytest.fixture(scope="session")
def raw(head: Head) -> RawScan:
    return scan_head(head, Damage(), seed=0)
