"""Read a scan file of any supported kind into one RawMesh, or say in one sentence why not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.errors import ScanError
from scanrender.scan.header import check_header
from scanrender.scan.memory import OUT_OF_MEMORY
from scanrender.scan.pages import Page
from scanrender.scan.raw import NO_PAGE, RawMesh
from scanrender.scan.topology import extent, span, used_vertices
from scanrender.settings.scan import ScanSettings

# What readers raise for structures that make no sense; RecursionError: JSON nested without end.
_STRAY = (
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    OSError,
    ArithmeticError,
    RecursionError,
)
_SAID = 120
LARGEST = 1e30  # coordinate


def read_scan(path: Path | str, settings: ScanSettings | None = None) -> RawMesh:
    """Read, triangulate and validate. `settings` is accepted for symmetry: units are decided later.

    Raises UsageError when the path is not there, ScanError when it is not a usable mesh.
    """
    path = Path(path)
    check_header(path)
    reader = _reader(path.suffix.lower())
    try:
        return _validated(reader(path), path)
    except ScanError:
        raise
    except MemoryError as error:
        raise ScanError(
            f"{path.name} does not fit into memory",
            str(path),
            OUT_OF_MEMORY,
        ) from error
    except _STRAY as error:
        # The words of a library say little to most people, but help whoever has to find out.
        said = " ".join(f"{type(error).__name__}: {error}".split())[:_SAID]
        raise ScanError(
            f"{path.name} is damaged or not what its name says",
            f"{path} ({said})",
            "export it again from the scanning software",
        ) from error


def _reader(suffix: str) -> Callable[[Path], RawMesh]:
    if suffix == ".obj":
        from scanrender.scan.read_obj import read_obj

        return read_obj
    if suffix == ".ply":
        from scanrender.scan.read_ply import read_ply

        return read_ply
    if suffix in (".glb", ".gltf"):
        from scanrender.scan.read_gltf import read_gltf

        return read_gltf
    from scanrender.scan.read_simple import read_off, read_stl

    return read_stl if suffix == ".stl" else read_off


def _validated(raw: RawMesh, path: Path) -> RawMesh:
    """Drop faces that name no vertex or a non-finite one; refuse a mesh with nothing left."""
    notes = list(raw.notes)
    where = str(path)
    if len(raw.positions) == 0 or len(raw.faces) == 0:
        what = "vertices" if len(raw.positions) == 0 else "faces (a point cloud?)"
        raise ScanError(f"{path.name} has no {what}", where, "mesh it first, then export it again")
    if raw.faces.min() < 0 or raw.faces.max() >= len(raw.positions):
        in_range = np.asarray(((raw.faces >= 0) & (raw.faces < len(raw.positions))).all(axis=1))
        notes.append(f"{int((~in_range).sum())} faces named vertices that do not exist: dropped")
        raw = _take(raw, in_range)
    # Beyond 1e30 float32 arithmetic overflows: as good as infinite. Comparisons with NaN fail.
    if not (raw.positions.min() > -LARGEST and raw.positions.max() < LARGEST):
        finite = np.asarray((np.abs(raw.positions) < LARGEST).all(axis=1))
        notes.append(f"{int((~finite).sum())} vertices are not finite: their faces are dropped")
        raw = _take(raw, np.asarray(finite[raw.faces].all(axis=1)))
    if len(raw.faces) == 0:
        raise ScanError(f"{path.name} has no usable face", where, "export it again")
    used = raw.positions[used_vertices(raw.faces, len(raw.positions))]
    if float(span(used).max()) <= 0.0:
        raise ScanError(
            f"{path.name} has no size: all its vertices coincide", where, "export it again"
        )
    raw = _usable_pages(_without_strays(raw), notes)
    if raw.colors is not None and _says_nothing(raw.colors):
        raw = replace(raw, colors=None)
        if raw.color_source == "none":
            notes.append("all vertices have the same grey, an exporter's default: it is ignored")
    if raw.color_source == "none" and not raw.pages and _has_coordinates(raw):
        notes.append("the scan has texture coordinates but no image: copy it beside the scan")
    return replace(raw, notes=tuple(notes))


def _without_strays(raw: RawMesh) -> RawMesh:
    """Without vertices that no face uses, where one lies outside the scan, or nowhere at all: the
    size of the scan is what tolerances are relative to."""
    kept = np.flatnonzero(used_vertices(raw.faces, len(raw.positions)))
    if len(kept) == len(raw.positions):
        return raw
    used = raw.positions[kept]
    low, high = extent(used)
    inside = (raw.positions >= low) & (raw.positions <= high)
    if inside.all():
        return raw
    new_index = np.zeros(len(raw.positions), np.int64)
    new_index[kept] = np.arange(len(kept))
    colors = None if raw.colors is None else raw.colors[kept]
    return replace(raw, positions=used, faces=new_index[raw.faces], colors=colors)


def _has_coordinates(raw: RawMesh) -> bool:
    return raw.corner_uv is not None and bool(np.isfinite(raw.corner_uv).any())


def _usable_pages(raw: RawMesh, notes: list[str]) -> RawMesh:
    """Texture coordinates for every face with a page: any will do for a page of one colour, and a
    face without coordinates loses its image."""
    page = np.full(len(raw.faces), NO_PAGE, np.int16) if raw.page is None else raw.page.copy()
    if not raw.pages:
        return replace(raw, page=page)
    uv = raw.corner_uv
    uv = np.full((len(raw.faces), 3, 2), np.nan, np.float32) if uv is None else uv.copy()
    missing = ~np.isfinite(uv).all(axis=(1, 2))
    plain = np.array([max(p.size) == 1 for p in raw.pages])
    constant = (page != NO_PAGE) & plain[page]
    uv[missing & constant] = 0.5
    for number, shown in enumerate(raw.pages):
        if not plain[number] and (page == number).any() and _is_flat(shown):
            notes.append(f"the texture {shown.name} is one flat colour: a placeholder?")
    lost = missing & ~constant & (page != NO_PAGE)
    if lost.any():
        notes.append(f"{int(lost.sum())} faces have an image but no texture coordinates")
        page[lost] = NO_PAGE
    return replace(raw, page=page, corner_uv=uv)


def _is_flat(page: Page) -> bool:
    coarse = page.pixels[:: max(1, page.size[1] // 256), :: max(1, page.size[0] // 256)]
    return bool((coarse == coarse[:1, :1]).all())


def _says_nothing(colors: npt.NDArray[Any]) -> bool:
    """One grey for every vertex is an exporter's default, not a measurement."""
    one = float(span(colors).max()) < 1e-3
    return one and float(np.ptp(colors.mean(axis=0))) < 0.02


def _take(raw: RawMesh, mask: npt.NDArray[np.bool_]) -> RawMesh:
    return replace(
        raw,
        faces=raw.faces[mask],
        corner_uv=None if raw.corner_uv is None else raw.corner_uv[mask],
        page=None if raw.page is None else raw.page[mask],
    )
