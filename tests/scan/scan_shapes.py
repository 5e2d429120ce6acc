"""Small meshes with known answers, and writers for the formats under test."""

from __future__ import annotations

from pathlib import Path

import numpy as np

SCANS = Path(__file__).parents[2].parent / "shared" / "scans"


def sphere(radius=50.0, rows=24, columns=48):
    """A closed UV sphere with texture coordinates per corner: positions, faces, corner_uv.

    corner_uv has its origin top left; the poles are fans, the seam is at longitude 0. Seen from
    outside, u grows to the right (toward growing longitude around +Y).
    """
    theta = np.linspace(0.0, np.pi, rows + 1)[1:-1]
    phi = 2.0 * np.pi * np.arange(columns) / columns
    ring = np.stack(
        [
            np.sin(theta)[:, None] * np.sin(phi),
            np.repeat(np.cos(theta)[:, None], columns, axis=1),
            np.sin(theta)[:, None] * np.cos(phi),
        ],
        axis=-1,
    ).reshape(-1, 3)
    positions = radius * np.concatenate([ring, [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]])
    north, south = len(ring), len(ring) + 1
    faces, uv = [], []

    def coordinate(row, column):
        return (column / columns, row / rows)

    for i in range(columns):
        j = (i + 1) % columns
        faces.append((north, i, j))
        uv.append([((i + 0.5) / columns, 0.0), coordinate(1, i), coordinate(1, i + 1)])
        for row in range(rows - 2):
            a, b = row * columns + i, row * columns + j
            c, d = a + columns, b + columns
            faces += [(a, c, d), (a, d, b)]
            ta, tb = coordinate(row + 1, i), coordinate(row + 1, i + 1)
            tc, td = coordinate(row + 2, i), coordinate(row + 2, i + 1)
            uv += [[ta, tc, td], [ta, td, tb]]
        last = (rows - 2) * columns
        faces.append((south, last + j, last + i))
        uv.append(
            [((i + 0.5) / columns, 1.0), coordinate(rows - 1, i + 1), coordinate(rows - 1, i)]
        )
    return positions, np.array(faces), np.array(uv)


def grid(function, side=41, half=20.0):
    """A square height field (open): positions (n, 3) with z = function(x, y), faces upward."""
    x, y = np.meshgrid(np.linspace(-half, half, side), np.linspace(-half, half, side))
    positions = np.stack([x, y, function(x, y)], axis=-1).reshape(-1, 3)
    a = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).reshape(-1)
    b, c, d = a + 1, a + side, a + side + 1
    return positions, np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])


def cube(side=1.0):
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float) * side
    faces = np.array(
        [
            (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
            (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
        ]
    )  # fmt: skip
    return corners, faces


def write_obj(path, positions, faces, corner_uv=None, mtl=None, material="skin", colors=None):
    lines = [f"mtllib {mtl}"] if mtl else []
    for i, p in enumerate(positions):
        tail = "" if colors is None else " " + " ".join(f"{c:.6f}" for c in colors[i])
        lines.append("v " + " ".join(f"{x:.9g}" for x in p) + tail)
    if corner_uv is not None:
        lines += [f"vt {u:.9g} {1 - v:.9g}" for u, v in corner_uv.reshape(-1, 2)]
    if mtl:
        lines.append(f"usemtl {material}")
    for i, f in enumerate(faces + 1):
        if corner_uv is None:
            lines.append("f " + " ".join(map(str, f)))
        else:
            lines.append("f " + " ".join(f"{v}/{3 * i + k + 1}" for k, v in enumerate(f)))
    path.write_text("\n".join(lines) + "\n")
    return path


def write_ply(path, positions, faces, colors=None, order="<"):
    """Binary PLY; colors (n, 3) uint8."""
    fields = [(k, order + "f4") for k in "xyz"]
    if colors is not None:
        fields += [(k, "u1") for k in ("red", "green", "blue")]
    vertex = np.zeros(len(positions), fields)
    for i, k in enumerate("xyz"):
        vertex[k] = positions[:, i]
    if colors is not None:
        for i, k in enumerate(("red", "green", "blue")):
            vertex[k] = colors[:, i]
    face = np.zeros(len(faces), [("n", "u1"), ("i", order + "i4", 3)])
    face["n"], face["i"] = 3, faces
    kind = "little" if order == "<" else "big"
    names = {"f4": "float", "u1": "uchar"}
    header = ["ply", f"format binary_{kind}_endian 1.0", f"element vertex {len(vertex)}"]
    header += [f"property {names[str(np.dtype(t).str)[1:]]} {k}" for k, t in fields]
    header += [f"element face {len(face)}", "property list uchar int vertex_indices", "end_header"]
    path.write_bytes(("\n".join(header) + "\n").encode() + vertex.tobytes() + face.tobytes())
    return path
