"""glTF files built in code for the tests of their reader."""

from __future__ import annotations

import json
import struct

import numpy as np
from scan_shapes import cube

from scanrender import images
from scanrender.scan.ingest import read_scan

NOISE = np.random.default_rng(0).integers(0, 256, (4, 4, 3)).astype(np.uint8)


class Gltf:
    """A glTF of one cube under construction; `document` is open for changes."""

    def __init__(self, index="<u2"):
        self.blob, self.views, self.accessors = b"", [], []
        self.positions, self.faces = cube()
        component = {"u1": 5121, "<u2": 5123, "<u4": 5125}[index]
        self.attributes = {"POSITION": self.add(self.positions.astype("<f4"), 5126, "VEC3")}
        indices = self.add(self.faces.astype(index).reshape(-1), component, "SCALAR")
        self.primitive = {"attributes": self.attributes, "indices": indices}
        self.document = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [self.primitive]}],
        }

    def view(self, data, **more):
        self.blob += b"\0" * (-len(self.blob) % 4)
        self.views.append(
            {"buffer": 0, "byteOffset": len(self.blob), "byteLength": len(data), **more}
        )
        self.blob += data
        return len(self.views) - 1

    def add(self, array, component, kind, **more):
        entry = {"componentType": component, "count": len(array), "type": kind, **more}
        self.accessors.append({"bufferView": self.view(array.tobytes()), **entry})
        return len(self.accessors) - 1

    def textured(self, folder, uv=None, **info):
        images.write_image(folder / "my skin.png", NOISE)
        uv = self.positions[:, :2] if uv is None else uv
        self.attributes["TEXCOORD_0"] = self.add(uv.astype("<f4"), 5126, "VEC2")
        self.primitive["material"] = 0
        color = {"baseColorTexture": {"index": 0, **info}}
        self.document["materials"] = [{"pbrMetallicRoughness": color}]
        self.document["textures"] = [{"source": 0}]
        self.document["images"] = [{"uri": "my%20skin.png"}]

    def read(self, path, uri=None):
        buffer = {"byteLength": len(self.blob), **({} if uri is None else {"uri": uri})}
        self.document.update(
            accessors=self.accessors, bufferViews=self.views,
            buffers=[buffer, *self.document.pop("more_buffers", [])],
        )  # fmt: skip
        text = json.dumps(self.document).encode()
        if path.suffix == ".gltf":
            path.write_bytes(text)
        else:
            text += b" " * (-len(text) % 4)
            chunks = struct.pack("<I4s", len(text), b"JSON") + text
            chunks += struct.pack("<I4s", len(self.blob), b"BIN\0") + self.blob
            path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
        return read_scan(path)


def volume(raw):
    a, b, c = (raw.positions[raw.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)
