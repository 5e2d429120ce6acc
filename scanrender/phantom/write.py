"""Phantoms as files: PLY with vertex colours, OBJ + MTL + PNG pages, and the truth beside them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanrender.files import atomic_path, make_folder, write_json, write_text
from scanrender.phantom.damage import RawScan, srgb_u8_from_linear
from scanrender.phantom.head import LABELS, Head, albedo_of_truth
from scanrender.phantom.noise import Array
from scanrender.phantom.unwrap import Atlas, rasterised, unwrap


def write_ply(path: Path | str, scan: RawScan | Head) -> Path:
    """Binary little-endian PLY with uchar sRGB vertex colours; raw units (Head: mm)."""
    positions, colours = _positions(scan), _colours(scan)
    # float32 resolves 1 part in 1.7e7; a georeferenced scan needs doubles.
    finite = positions[np.isfinite(positions).all(axis=1)]
    far = float(np.abs(finite).max()) > 200.0 * float(np.ptp(finite, axis=0).max())
    kind, code = ("double", "<f8") if far else ("float", "<f4")
    vertices = np.empty(len(positions), dtype=[("xyz", code, 3), ("rgb", "u1", 3)])
    vertices["xyz"], vertices["rgb"] = positions, colours
    faces = np.empty(len(scan.faces), dtype=[("count", "u1"), ("index", "<i4", 3)])
    faces["count"], faces["index"] = 3, scan.faces
    header = ["ply", "format binary_little_endian 1.0", "comment scanrender phantom"]
    header += [f"element vertex {len(positions)}"]
    header += [f"property {kind} {axis}" for axis in "xyz"]
    header += [f"property uchar {name}" for name in ("red", "green", "blue")]
    header += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        stream.write(("\n".join(header) + "\n").encode("ascii"))
        stream.write(vertices.tobytes())
        stream.write(faces.tobytes())
    return Path(path)


def write_obj(path: Path | str, scan: RawScan | Head, pages: int = 1, page_px: int = 2048) -> Path:
    """OBJ, MTL and `pages` sRGB PNG pages of the procedural albedo, finer than the vertices.

    `path` ends in .obj, or is a folder that gets scan.obj. The OBJ is written last, so that it
    never names a file that is not there.
    """
    path = Path(path)
    if path.suffix.lower() != ".obj":
        path = path / "scan.obj"
    truth_mm = np.nan_to_num(_truth_positions(scan))
    atlas = unwrap(truth_mm, scan.faces, pages, page_px)
    seed = scan.seed if isinstance(scan, Head) else scan.head_seed
    from scanrender.images import write_png8

    materials = []
    for page in range(pages):
        image = _baked_page(truth_mm, scan.faces, atlas, page, page_px, seed)
        name = f"{path.stem}_{page}.png"
        write_png8(path.with_name(name), image / 255.0)
        materials += [f"newmtl page_{page}", "Kd 1 1 1", "Ks 0 0 0", "illum 1"]
        materials += [f"map_Kd {name}", ""]
    write_text(path.with_suffix(".mtl"), "\n".join(materials))
    with atomic_path(path) as temporary, temporary.open("w", encoding="ascii") as stream:
        stream.write(f"# scanrender phantom\nmtllib {path.stem}.mtl\n")
        stream.write(_lines("v %.6f %.6f %.6f\n", _positions(scan)))
        uv = np.stack([atlas.texels[:, 0], page_px - atlas.texels[:, 1]], axis=1) / page_px
        stream.write(_lines("vt %.6f %.6f\n", uv))
        for page in range(pages):
            rows = atlas.page == page
            pairs = np.stack([scan.faces[rows], atlas.corner[rows]], axis=-1).reshape(-1, 6) + 1
            stream.write(f"usemtl page_{page}\n")
            stream.write(_lines("f %d/%d %d/%d %d/%d\n", pairs))
    return path


def write_truth(folder: Path | str, head: Head, raw: RawScan | None = None) -> Path:
    """clean.ply (mm), truth.npz (positions, faces, albedo, label) and truth.json in `folder`.

    With `raw`, its raw_from_truth and unit go into the JSON, and its truth_vertex into the npz.
    """
    folder = make_folder(Path(folder))
    write_ply(folder / "clean.ply", head)
    arrays: dict[str, NDArray[np.generic]] = {
        "positions_mm": head.positions_mm,
        "faces": head.faces,
        "albedo_linear": head.albedo_linear,
        "label": head.label,
    }
    document = {
        "units": "mm",
        "colour": "lin_rec709_scene",
        "labels": list(LABELS),
        "seed": head.seed,
        "vertices": len(head.positions_mm),
        "triangles": len(head.faces),
        "spacing_mm": head.spacing_mm,
    }
    if raw is not None:
        arrays["truth_vertex"] = raw.truth_vertex
        document["raw_from_truth"] = raw.raw_from_truth.tolist()
        document["mm_per_unit"] = raw.mm_per_unit
    with atomic_path(folder / "truth.npz") as temporary, temporary.open("wb") as stream:
        np.savez(stream, allow_pickle=False, **arrays)
    write_json(folder / "truth.json", document)
    return folder


def _positions(scan: RawScan | Head) -> Array:
    return scan.positions_mm if isinstance(scan, Head) else scan.positions


def _colours(scan: RawScan | Head) -> NDArray[np.uint8]:
    if isinstance(scan, Head):
        return srgb_u8_from_linear(scan.albedo_linear)
    return scan.colours_srgb_u8


def _truth_positions(scan: RawScan | Head) -> Array:
    """(n, 3) mm in the truth frame."""
    if isinstance(scan, Head):
        return scan.positions_mm
    inverse = np.linalg.inv(scan.raw_from_truth)
    return np.asarray(scan.positions @ inverse[:3, :3].T + inverse[:3, 3])


def _baked_page(
    positions_mm: Array, faces: NDArray[np.int32], atlas: Atlas, page: int, page_px: int, seed: int
) -> NDArray[np.uint8]:
    """(page_px, page_px, 3) sRGB codes; texels outside charts take the nearest inside colour."""
    from scipy import ndimage

    image = np.zeros((page_px * page_px, 3), dtype=np.uint8)
    covered = np.zeros(page_px * page_px, dtype=bool)
    for index, face, weight in rasterised(atlas, page, page_px):
        points = np.einsum("kc,kcx->kx", weight, positions_mm[faces[face]])
        image[index] = srgb_u8_from_linear(albedo_of_truth(points, atlas.mm_per_texel, seed))
        covered[index] = True
    if not covered.any():
        return image.reshape(page_px, page_px, 3)
    empty = ~covered.reshape(page_px, page_px)
    nearest = ndimage.distance_transform_edt(empty, return_distances=False, return_indices=True)
    square = image.reshape(page_px, page_px, 3)
    return np.asarray(square[nearest[0], nearest[1]])


def _lines(pattern: str, rows: NDArray[np.generic]) -> str:
    """One formatted line per row: a single % over the repeated pattern, the fastest plain way."""
    return pattern * len(rows) % tuple(rows.ravel().tolist())
