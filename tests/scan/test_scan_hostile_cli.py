"""Hostile and broken scans through the program itself: `scanrender prep`, one process each.

Each ends as an asset, or with exit code 4 and one sentence; with no traceback, nothing
half-written, bounded memory, and without anything outside the scan's folder having been opened.
"""

from __future__ import annotations

import ctypes
import json
import os
import struct
import subprocess
import sys
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scan_shapes import sphere, write_obj, write_ply

from scanrender import images
from scanrender.asset import load_asset

SQUARE = "v 0 0 0\nv 200 0 0\nv 200 200 0\nv 0 200 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FACES = "usemtl a\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
TINY = {
    "prep.bake.albedo_px": 32,
    "prep.bake.normal_px": 32,
    "prep.bake.data_px": 32,
    "prep.bake.ao_rays": 4,
    "prep.bake.thickness_rays": 1,
    "prep.report": "short",
    "prep.memory_mib": 700,
}
MIB = 1 << 20
SKIN = (0.8, 0.5, 0.4)
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="inotify and rusage of children")


class Opened:
    """How often files of a folder are opened, by whatever library: the kernel's own count."""

    IN_OPEN, IN_NONBLOCK = 0x20, 0o4000

    def __init__(self, folder: Path) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        self.fd = libc.inotify_init1(self.IN_NONBLOCK)
        assert libc.inotify_add_watch(self.fd, os.fsencode(folder), self.IN_OPEN) >= 0

    def names(self) -> list[str]:
        """The names of files opened so far; folders that were listed are not files."""
        try:
            data = os.read(self.fd, MIB)
        except BlockingIOError:
            return []
        found, position = [], 0
        while position < len(data):
            _, _, _, size = struct.unpack_from("iIII", data, position)
            name = data[position + 16 : position + 16 + size].rstrip(b"\0")
            found += [os.fsdecode(name)] if name else []
            position += 16 + size
        return found


def png_bomb(side):
    """A PNG of a few hundred kB that decodes to 3 * side^2 bytes of black."""

    def chunk(kind, data):
        crc = struct.pack(">I", zlib.crc32(kind + data))
        return struct.pack(">I", len(data)) + kind + data + crc

    row = bytes(1 + 3 * side)
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    block = packer.compress(row) + packer.flush(zlib.Z_FULL_FLUSH)
    check = 1
    for _ in range(side):
        check = zlib.adler32(row, check)
    body = b"\x78\x01" + block * side + b"\x03\0" + struct.pack(">I", check)
    header = struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    chunks = chunk(b"IHDR", header) + chunk(b"IDAT", body) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks


def empty(folder):
    (folder / "a.obj").write_bytes(b"")
    return folder / "a.obj"


def truncated(folder):
    positions, faces, _ = sphere(100.0, 8, 16)
    path = write_ply(folder / "a.ply", positions, faces)
    path.write_bytes(path.read_bytes()[:-500])
    return path


def lying_header(folder):
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 1000000000\nproperty float x\n"
    head += "property float y\nproperty float z\nelement face 1000000000\n"
    head += "property list uchar int vertex_indices\nend_header\n"
    (folder / "a.ply").write_bytes(head.encode() + bytes(5000))
    return folder / "a.ply"


def degenerate(folder):
    (folder / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\nf 1 1 2\n")
    return folder / "a.obj"


def point_cloud(folder):
    return write_ply(folder / "a.ply", np.random.default_rng(0).random((50, 3)), np.zeros((0, 3)))


def loose_pieces(folder):
    """10^5 triangles that share nothing."""
    rng = np.random.default_rng(0)
    corners = rng.normal(size=(100_000, 1, 3)) * 100 + rng.random((100_000, 3, 3))
    faces = np.arange(300_000).reshape(-1, 3)
    return write_ply(folder / "a.ply", corners.reshape(-1, 3), faces)


def image_bomb(folder):
    (folder / "m.mtl").write_text("newmtl a\nmap_Kd bomb.png\n")
    (folder / "bomb.png").write_bytes(png_bomb(16384))
    (folder / "a.obj").write_text(f"mtllib m.mtl\n{SQUARE}{FACES}")
    return folder / "a.obj"


def names(reference):
    def write(folder):
        (folder / "m.mtl").write_text(f"newmtl a\nmap_Kd {reference}\n")
        (folder / "a.obj").write_text(f"mtllib m.mtl\n{SQUARE}{FACES}")
        return folder / "a.obj"

    return write


def link(folder):
    (folder / "skin.png").symlink_to(folder.parent / "outside" / "secret.png")
    return names("skin.png")(folder)


def linked_folder(name):
    def write(folder):
        (folder / "textures").symlink_to(folder.parent / "outside")
        return names(f"textures/{name}")(folder)

    return write


def lone_link(folder):
    """An image that nothing names, but that lies alone beside the scan."""
    (folder / "a.png").symlink_to(folder.parent / "outside" / "secret.png")
    positions, faces, uv = sphere(100.0, 8, 16)
    return write_obj(folder / "a.obj", positions, faces, uv)


def gltf(uri):
    def write(folder):
        document = {
            "asset": {"version": "2.0"},
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "buffers": [{"byteLength": 36, "uri": uri}],
        }
        (folder / "a.gltf").write_text(json.dumps(document))
        return folder / "a.gltf"

    return write


def indices_out_of_range(folder):
    positions, faces, _ = sphere(100.0, 8, 16)
    faces[:5] = [[0, 1, 10**6], [-7, 2, 3], [0, 1, 2**31 - 1], [2, 3, 10**5], [999, 998, 997]]
    return write_ply(folder / "a.ply", positions, faces)


def not_finite(folder):
    positions, faces, _ = sphere(100.0, 8, 16)
    positions[[3, 40, 77]] = [[np.nan, 0, 0], [np.inf, 1, 1], [0, -np.inf, 3e38]]
    far = np.concatenate([positions, [[1e25, 0, 0]]])  # and one that no face uses
    return write_ply(folder / "a.ply", far, faces)


def one_triangle(folder):
    (folder / "a.obj").write_text("v 0 0 0\nv 90 0 0\nv 0 220 0\nf 1 2 3\n")
    return folder / "a.obj"


def odd_name(folder):
    positions, faces, uv = sphere(100.0, 8, 16)
    images.write_png8(folder / "Haut & Haar ü.png", np.full((8, 8, 3), SKIN))
    (folder / "мой файл.mtl").write_text("newmtl haut 1\nmap_Kd Haut & Haar ü.png\n")
    name = folder / "Übung 1 – голова.OBJ"
    return write_obj(name, positions, faces, uv, "мой файл.mtl", "haut 1")


def far_small_and_inside_out(folder):
    """5 * 10^6 m away, in units of a micrometre, with the inside turned out."""
    positions, faces, _ = sphere(100.0, 8, 16)
    path = write_ply(folder / "a.ply", positions, faces[:, ::-1])
    lines = ["ply", "format ascii 1.0", f"element vertex {len(positions)}"]
    lines += [f"property double {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(f"{x:.9f}" for x in row) for row in positions * 1e-6 + 5e6]
    lines += [f"3 {c} {b} {a}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


# The scan, and a word of the sentence that refuses it, or None where it becomes an asset.
CASES = {
    "empty": (empty, "is empty"),
    "truncated": (truncated, "ends before its"),
    "10^9 vertices declared": (lying_header, "ends before its 1000000000 vertex"),
    "all degenerate": (degenerate, "none of its triangles has an area"),
    "point cloud": (point_cloud, "a point cloud?"),
    "10^5 components": (loose_pieces, "loose pieces of 1.0 triangles each"),
    "image bomb": (image_bomb, "does not fit into memory"),
    "MTL names ../": (names("../outside/secret.png"), "outside the scan's folder"),
    "glTF names ../": (gltf("../outside/secret.bin"), "outside the scan's folder"),
    "glTF names a URL": (gltf("file:///etc/passwd"), "outside the scan's folder"),
    "link out of the folder": (link, "a link that leaves the scan's folder"),
    "folder linked out of the folder": (linked_folder("secret.png"), "a link that leaves"),
    "folder linked out, searched": (linked_folder("Secret.PNG"), None),
    "lone image that is a link": (lone_link, None),
    "indices out of range": (indices_out_of_range, None),
    "NaN and infinite coordinates": (not_finite, None),
    "one triangle": (one_triangle, None),
    "non-ASCII and spaced names": (odd_name, None),
    "far away, tiny, inside out": (far_small_and_inside_out, None),
}
MORE = {"far away, tiny, inside out": ["--set", "scan.height_mm=200", "--set", "scan.up=+y"]}

# The kernel's record of a child's memory starts at what its parent held when it started it: with
# pytest as the parent, every child would be as large as all tests before it made pytest.
COUNTED = """
import os, sys
out = os.open(sys.argv[1], os.O_WRONLY)
child = os.posix_spawn(sys.argv[2], sys.argv[2:], os.environ, file_actions=[
    (os.POSIX_SPAWN_DUP2, out, 1)])
_, status, usage = os.wait4(child, 0)
print(os.waitstatus_to_exitcode(status), usage.ru_maxrss)
"""


@dataclass
class Ended:
    code: int
    out: str
    err: str
    peak_mib: float
    left: list[str]
    asset: Path


def run(name: str, folder: Path) -> Ended:
    scan = CASES[name][0](folder)
    results = folder.parent / f"{folder.name} out"
    results.mkdir()
    command = [sys.executable, "-m", "scanrender", "prep", str(scan), "--as-is", "--json"]
    command += ["--out", str(results / "asset"), "--progress", "none", *MORE.get(name, [])]
    for key, value in TINY.items():
        command += ["--set", f"{key}={value}"]
    if "components" in name:  # the one whose simplification is what fails
        command.remove("--as-is")
    said = [folder.with_suffix(suffix) for suffix in (".out", ".err")]
    with said[0].open("w") as out, said[1].open("w") as err:
        counter = [sys.executable, "-S", "-c", COUNTED, out.name, *command]
        counted = subprocess.run(counter, stdout=subprocess.PIPE, stderr=err, text=True, check=True)
    code, peak_kib = (int(word) for word in counted.stdout.split())
    texts = [path.read_text() for path in said]
    left = sorted(path.name for path in results.iterdir())
    return Ended(code, *texts, peak_kib / 1024, left, results / "asset")


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """How each ended, and which files outside their folders were opened meanwhile."""
    root = tmp_path_factory.mktemp("hostile")
    outside = root / "outside"
    outside.mkdir()
    images.write_png8(outside / "secret.png", np.random.default_rng(0).random((8, 8, 3)))
    (outside / "secret.bin").write_bytes(np.eye(3, dtype="<f4").tobytes())
    watch = Opened(outside)
    (outside / "secret.bin").read_bytes()
    assert watch.names() == ["secret.bin"], "otherwise the watch sees nothing"
    folders = {}
    for number, name in enumerate(CASES):
        folders[name] = root / f"case {number}"
        folders[name].mkdir()
    with ThreadPoolExecutor(2) as pool:
        ended = dict(zip(CASES, pool.map(run, CASES, folders.values()), strict=True))
    return ended, watch.names()


@pytest.mark.parametrize("name", [name for name, (_, word) in CASES.items() if word])
def test_refused_in_one_sentence_with_exit_code_4(answers, name):
    ended = answers[0][name]
    lines = ended.err.strip().splitlines()
    assert ended.code == 4, ended.err
    assert lines[0].startswith("scanrender: ")
    assert CASES[name][1].lower() in lines[0].lower()
    assert 2 <= len(lines) <= 3, "what, where, what to do"
    assert len(lines[0]) < 220
    assert ended.left == []


@pytest.mark.parametrize("name", [name for name, (_, word) in CASES.items() if not word])
def test_asset_in_spite_of(answers, name):
    ended = answers[0][name]
    assert ended.code == 0, ended.err
    assert ended.left == ["asset"]
    asset = load_asset(ended.asset)
    assert np.isfinite(asset.mesh.positions_mm).all()
    for pixels in asset.maps.values():
        assert np.isfinite(pixels).all()


def test_what_was_dropped_is_said(answers):
    for name, word in (
        ("indices out of range", "5 faces named vertices that do not exist"),
        ("NaN and infinite coordinates", "3 vertices are not finite"),
    ):
        warnings = json.loads(answers[0][name].out)["warnings"]
        assert any(word in warning for warning in warnings), warnings


def test_far_tiny_and_inside_out_is_the_sphere_it_was(answers):
    """The text holds nanometres of a metre, that is 1e-3 of one of its 1e-6 units."""
    mesh = load_asset(answers[0]["far away, tiny, inside out"].asset).mesh
    radius = np.linalg.norm(mesh.positions_mm, axis=1)
    np.testing.assert_allclose(radius, 100.0, rtol=2e-3)
    outward = np.einsum("ij,ij->i", mesh.normals, mesh.positions_mm) / radius
    assert outward.min() > 0.9


def test_the_colours_of_an_oddly_named_texture_arrive(answers):
    albedo = load_asset(answers[0]["non-ASCII and spaced names"].asset).maps["albedo"]
    expected = images.linear_from_srgb(np.array(SKIN))
    np.testing.assert_allclose(albedo.mean(axis=(0, 1)), expected, atol=0.02)


@pytest.mark.parametrize("name", CASES)
def test_memory_stays_bounded(answers, name):
    assert answers[0][name].peak_mib < TINY["prep.memory_mib"]


def test_no_file_outside_the_folders_was_opened(answers):
    assert answers[1] == []
