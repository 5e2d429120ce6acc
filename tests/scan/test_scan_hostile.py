"""Hostile and broken files: one sentence, bounded memory, nothing read outside the scan's folder.

All files are read in one process of their own, which reports how each ended and how much memory
it took at most.
"""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest
from scan_shapes import cube, sphere, write_obj, write_ply

from scanrender import images
from scanrender.scan.clean import clean
from scanrender.scan.ingest import read_scan
from scanrender.scan.inspect import inspect_scan
from scanrender.settings.prep import CleanSettings
from scanrender.settings.scan import ScanSettings

BILLION = 10**9
XYZ = "property float x\nproperty float y\nproperty float z\n"
BINARY = "ply\nformat binary_little_endian 1.0\n"
ASCII = "ply\nformat ascii 1.0\n"
INDICES = "property list uchar int vertex_indices\n"
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FACES = "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"


def ply(kind, vertices, faces, body, face=INDICES):
    head = f"{kind}element vertex {vertices}\n{XYZ}element face {faces}\n{face}end_header\n"
    return head.encode() + body


def glb(document, blob=b""):
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(blob), b"BIN\0") + blob
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def gltf(accessor=None, nodes=None, **more):
    """A document of one triangle whose positions are `accessor`."""
    positions = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}
    return {
        "asset": {"version": "2.0"},
        "nodes": nodes or [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{**positions, **(accessor or {})}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36}],
        **more,
    }


def png_header(width, height, padding=3_000_000):
    """A PNG that says it is so large and holds next to nothing. The padding is a comment, without
    which OpenImageIO already finds the size implausible."""

    def chunk(kind, data):
        crc = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + crc

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"tEXt", b"a\0" + b"x" * padding)
    body += chunk(b"IDAT", zlib.compress(b"\0" * 1000))
    return b"\x89PNG\r\n\x1a\n" + body + chunk(b"IEND", b"")


TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
CUBE_PLY = ply(BINARY, 8, 12, cube()[0].astype("<f4").tobytes() + b"\3\0\0\0\0" * 9)
# name: (bytes, a word of the sentence)
REFUSED = {
    "empty.obj": (b"", "empty"),
    "empty.ply": (b" \n", "empty"),
    "no-faces.ply": (ply(ASCII, 1, 0, b"0 0 0\n"), "point cloud"),
    "cut-in-vertices.ply": (CUBE_PLY[:200], "ends before"),
    "cut-in-faces.ply": (CUBE_PLY, "ends before"),
    "lying-vertices.ply": (ply(BINARY, BILLION, 1, b"\0" * 99), "ends before"),
    "lying-vertices-ascii.ply": (ply(ASCII, BILLION, 1, b"0 0 0\n"), "ends before"),
    "lying-faces.ply": (ply(BINARY, 3, BILLION, TRIANGLE + b"\3"), "ends before"),
    "lying-list.ply": (
        ply(BINARY, 3, 1, TRIANGLE + struct.pack("<I", 2**31),
            "property list uint int vertex_indices\n"), "ends before"),
    "negative.ply": (ply(BINARY, -5, 1, TRIANGLE), "ends before"),
    "empty-elements.ply": (
        f"{BINARY}element nothing {BILLION}\nelement vertex 0\n{XYZ}end_header\n".encode(),
        "no vertices"),
    "lying.stl": (b"\0" * 80 + struct.pack("<I", BILLION) + b"\0" * 500, "ends before"),
    "cut.stl": (b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0", "triangle"),
    "lying.off": (f"OFF\n{BILLION} {BILLION} 0\n0 0 0\n".encode(), "ends before"),
    "lying-face.off": (f"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n{BILLION} 0 1\n".encode(), "cut short"),
    "lying-accessor.glb": (glb(gltf({"count": BILLION}), TRIANGLE), "leaves its buffer"),
    "lying-zeros.glb": (
        glb(gltf({"count": BILLION, "bufferView": 0} | {"bufferView": None})
            | {"accessors": [{"componentType": 5126, "count": BILLION, "type": "VEC3"}]}),
        "where it has no data"),
    "lying-length.glb": (b"glTF" + struct.pack("<II", 2, 2**31) + b"\0" * 40, "cut short"),
    "loop.glb": (glb(gltf(nodes=[{"children": [1]}, {"children": [0]}]), TRIANGLE), "loop"),
    # 40 lines that say 2^40 nodes.
    "doubling.glb": (
        glb(gltf(nodes=[{"children": [i + 1, i + 1]} for i in range(40)] + [{"mesh": 0}]),
            TRIANGLE), "loop"),
    # Bulk conversions take the longest word's width for all of them: 150 GB here.
    "long-word.obj": (
        b"v 0 0 0\n" * 50_000 + b"v 0 0 " + b"1" * 1_000_000 + b"\nf 1 2 3\n",
        "is not made of numbers"),
    "long-word.off": (
        b"OFF\n50001 1 0\n" + b"0 0 0\n" * 50_000 + b"0 0 " + b"1" * 1_000_000 + b"\n3 0 1 2\n",
        "damaged"),
    "nested.gltf": (b'{"asset":' + b"[" * 200_000, "not valid glTF JSON"),
    "no-index.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 7 8 9\nf -7 -8 -9\n", "no usable face"),
    "not-finite.obj": (b"v nan 0 0\nv inf 0 0\nv 0 -inf 0\nf 1 2 3\n", "no usable face"),
    "degenerate.obj": (b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\nf 1 1 2\n", "has an area"),
    "one-point.obj": (b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "no size"),
    "bomb.obj": (f"mtllib bomb.mtl\n{SQUARE}usemtl a\n{FACES}".encode(), "60000 x 60000"),
    "bomb.glb": (
        glb(gltf(
            materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
            textures=[{"source": 0}], images=[{"bufferView": 1}],
            bufferViews=[{"buffer": 0, "byteLength": 36},
                         {"buffer": 0, "byteOffset": 36,
                          "byteLength": len(png_header(60000, 60000))}],
            buffers=[{"byteLength": 36 + len(png_header(60000, 60000))}],
            meshes=[{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        ), TRIANGLE + png_header(60000, 60000)), "60000 x 60000"),
    "cut-image.obj": (f"mtllib cut.mtl\n{SQUARE}usemtl a\n{FACES}".encode(), "cut.png"),
    "up.obj": (f"mtllib ../secret.mtl\n{SQUARE}{FACES}".encode(), "outside"),
    "absolute.obj": (f"mtllib /etc/passwd\n{SQUARE}{FACES}".encode(), "outside"),
    "url.obj": (f"mtllib https://x.org/a.mtl\n{SQUARE}{FACES}".encode(), "outside"),
    "share.obj": (f"mtllib \\\\host\\share\\a.mtl\n{SQUARE}{FACES}".encode(), "outside"),
    "link.obj": (f"mtllib link.mtl\n{SQUARE}{FACES}".encode(), "leaves the scan's folder"),
    "up.ply": (
        b"ply\nformat ascii 1.0\ncomment TextureFile ../secret.png\n" + b"element vertex 0\n"
        + XYZ.encode() + b"end_header\n", "outside"),
    "up.gltf": (
        json.dumps(gltf(buffers=[{"byteLength": 36, "uri": "..%2Fsecret.bin"}])).encode(),
        "outside"),
    "pipe.obj": (None, "not a regular file"),
}  # fmt: skip

READ_ALL = """
import json, sys, time
from pathlib import Path
from scanrender.errors import ScanrenderError
from scanrender.scan.inspect import inspect_scan
from scanrender.scan.journal import peak_mib
ended = {}
inspect_scan(Path(sys.argv[1]).parent / "good.obj")  # imports are not what is measured
for name in sys.argv[2:]:
    try:
        inspect_scan(Path(sys.argv[1]) / name)
        ended[name] = ["read", "", ""]
    except ScanrenderError as error:
        ended[name] = [type(error).__name__, error.what, error.fix or ""]
    except Exception as error:
        ended[name] = ["CRASH", repr(error), ""]
    ended[name].append(peak_mib())
print(json.dumps(ended))
"""


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """How reading each hostile file ended: kind of error, sentence, what to do, peak MiB so far."""
    outside = tmp_path_factory.mktemp("outside")
    folder = outside / "scan"
    folder.mkdir()
    (outside / "good.obj").write_text(SQUARE + FACES)
    (outside / "secret.mtl").write_text("newmtl a\nKd 1 0 0\n")
    (outside / "secret.bin").write_bytes(TRIANGLE)
    images.write_png8(outside / "secret.png", np.zeros((2, 2, 3)))
    (folder / "link.mtl").symlink_to(outside / "secret.mtl")
    for name in ("bomb", "cut"):
        (folder / f"{name}.mtl").write_text(f"newmtl a\nmap_Kd {name}.png\n")
    (folder / "bomb.png").write_bytes(png_header(60_000, 60_000))
    images.write_png8(folder / "cut.png", np.random.default_rng(0).random((64, 64, 3)))
    (folder / "cut.png").write_bytes((folder / "cut.png").read_bytes()[:4000])
    for name, (content, _) in REFUSED.items():
        if content is None:
            os.mkfifo(folder / name)
        else:
            (folder / name).write_bytes(content)
    command = [sys.executable, "-c", READ_ALL, str(folder), *REFUSED]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", list(REFUSED))
def test_hostile_files_end_in_one_sentence(answers, name):
    kind, sentence, fix, _ = answers[name]
    assert kind == "ScanError", sentence
    assert REFUSED[name][1] in sentence
    assert "\n" not in sentence + fix
    assert fix, "what to do"
    assert len(sentence) < 200
    for leak in ("Errno", "dtype", "object has no", "buffer is smaller", "root:x"):
        assert leak not in sentence


def test_memory_stays_bounded_whatever_a_header_declares(answers):
    peaks = [answers[name][3] for name in REFUSED]
    assert max(peaks) - peaks[0] < 200, "MiB; 10^9 vertices would be 12 GB"


def test_a_path_of_another_machine_is_forgiven_when_the_file_lies_beside(tmp_path):
    positions, faces, uv = sphere(rows=4, columns=6)
    images.write_png8(tmp_path / "skin.png", np.random.default_rng(0).random((4, 4, 3)))
    for name in (r"C:\Users\someone\skin.png", "/home/someone/skin.png", "../tex/skin.png"):
        (tmp_path / "m.mtl").write_text(f"newmtl skin\nmap_Kd {name}\n")
        raw = read_scan(write_obj(tmp_path / "a.obj", positions, faces, uv, "m.mtl"))
        assert raw.color_source == "texture"


def test_one_triangle_and_many_pieces_are_read(tmp_path):
    (tmp_path / "one.obj").write_text("v 0 0 0\nv 90 0 0\nv 0 220 0\nf 1 2 3\n")
    assert inspect_scan(tmp_path / "one.obj")["boundary_edges"] == 3
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(100_000, 1, 3)) * 100 + rng.random((100_000, 3, 3))
    soup = write_ply(
        tmp_path / "soup.ply", corners.reshape(-1, 3), np.arange(300_000).reshape(-1, 3)
    )
    assert inspect_scan(soup)["components"] == 100_000
    cleaned = clean(read_scan(soup), ScanSettings(units="mm"), CleanSettings())
    # A flake's rim is not a hole, and a triangle alone has no inside to be turned out.
    steps = {step["step"]: step for step in cleaned.steps}
    assert steps["fill holes"]["holes"] == 0
    assert steps["orient"]["turned_inside_out"] == steps["orient"]["turned_to_agree"] == 0
    assert 90_000 < len(cleaned.surface.faces) < 100_000


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("inside_out", [False, True])
def test_size_and_side_do_not_matter(tmp_path, scale, inside_out):
    positions, faces, _ = sphere(100.0, 12, 24)
    faces = faces[:, ::-1] if inside_out else faces
    scan = write_ply(tmp_path / "a.ply", positions * scale, faces)
    settings = ScanSettings(height_mm=200.0)
    cleaned = clean(read_scan(scan), settings, CleanSettings()).surface
    np.testing.assert_allclose(np.linalg.norm(cleaned.positions, axis=1), 100.0, rtol=1e-5)
    a, b, c = (cleaned.positions[cleaned.faces[:, i]] for i in range(3))
    assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0


@pytest.mark.parametrize("suffix", ["obj", "stl", "off", "ply"])
def test_five_million_metres_away_no_precision_is_lost(tmp_path, suffix):
    """As text, in metres: what a georeferenced export holds, to the micrometre."""
    positions, faces, _ = sphere(0.15, 12, 24)
    far = positions + np.array([5e6, 5e6, 120.0])
    rows = [f"{x:.6f} {y:.6f} {z:.6f}" for x, y, z in far]
    if suffix == "obj":
        text = "".join(f"v {row}\n" for row in rows)
        text += "".join(f"f {a} {b} {c}\n" for a, b, c in faces + 1)
    elif suffix == "stl":
        text = "solid far\n"
        for face in faces:
            corners = "".join(f"vertex {rows[i]}\n" for i in face)
            text += f"facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n"
        text += "endsolid far\n"
    else:
        head = f"OFF\n{len(rows)} {len(faces)} 0\n"
        if suffix == "ply":
            doubles = XYZ.replace("float", "double")
            head = f"{ASCII}element vertex {len(rows)}\n{doubles}element face {len(faces)}\n"
            head += f"{INDICES}end_header\n"
        text = head + "\n".join(rows) + "\n"
        text += "".join(f"3 {a} {b} {c}\n" for a, b, c in faces)
    path = tmp_path / f"far.{suffix}"
    path.write_text(text)
    cleaned = clean(read_scan(path), ScanSettings(units="m"), CleanSettings()).surface
    radius = np.linalg.norm(cleaned.positions, axis=1)
    np.testing.assert_allclose(radius, 150.0, atol=2e-3)  # mm: the text's own rounding
