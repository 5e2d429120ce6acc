"""The container side of glTF 2.0: GLB chunks, buffers, accessors, images. No meshes here.

Khronos glTF 2.0 specification, sections 3.6 (buffers and accessors) and 4 (GLB). Every reference
is a data URI, a buffer view, or a file in the scan's own folder; nothing is fetched.
"""

from __future__ import annotations

import base64
import json
import re
import tempfile
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from scanrender.errors import ScanError
from scanrender.scan.pages import Encoding, Page, read_page
from scanrender.scan.printable import printable
from scanrender.scan.safe_path import inside

_COMPONENT = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_MOST_ZEROS = 1 << 28
_UNDERSTOOD = {
    "KHR_draco_mesh_compression", "EXT_texture_webp", "KHR_mesh_quantization",
    "KHR_texture_transform", "KHR_materials_unlit", "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular", "KHR_materials_ior", "KHR_lights_punctual",
    "KHR_materials_emissive_strength", "KHR_materials_clearcoat", "KHR_materials_sheen",
    "KHR_materials_transmission", "KHR_materials_volume", "KHR_xmp_json_ld",
    "KHR_materials_variants",
}  # fmt: skip


class GltfFile:
    """A parsed .gltf or .glb; arrays and images on request."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.binary = b""
        data = path.read_bytes()
        text = self._chunks(data) if data[:4] == b"glTF" else data
        try:
            self.json: dict[str, Any] = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise ScanError(
                f"{path.name} is not valid glTF JSON", str(path), "copy or export it again"
            ) from error
        if not isinstance(self.json, dict):
            raise ScanError(f"{path.name} is not a glTF document", str(path), "export it again")
        version = str(self.json.get("asset", {}).get("version", "2.0"))
        if not version.startswith("2"):
            raise self._old(printable(version[:10]))
        unknown = set(self.json.get("extensionsRequired", [])) - _UNDERSTOOD
        if unknown:
            names = printable(", ".join(sorted(unknown)))
            raise ScanError(
                f"{path.name} requires {names}, which is not supported",
                str(path),
                "export it without that extension, or with Draco instead",
            )
        self._buffers: dict[int, bytes] = {}
        self._pages: dict[tuple[int, Encoding], Page | None] = {}

    def _old(self, version: str) -> ScanError:
        return ScanError(
            f"{self.path.name} is glTF {version}, of which only 2 is supported",
            str(self.path),
            "export it as glTF 2.0",
        )

    def entry(self, kind: str, index: Any) -> dict[str, Any]:
        """Entry `index` of the list `kind`. Python would count from the end for negative ones."""
        entries = self.json.get(kind, [])
        if not isinstance(index, int) or not 0 <= index < len(entries):
            raise ScanError(
                f"{self.path.name} names {kind} {printable(str(index)[:20])}, "
                f"of which it has {len(entries)}",
                str(self.path),
                "export it again",
            )
        found: dict[str, Any] = entries[index]
        return found

    def _chunks(self, data: bytes) -> bytes:
        text = b""
        declared = int.from_bytes(data[8:12], "little")
        if len(data) < declared or len(data) < 20:
            raise ScanError(
                f"{self.path.name} is cut short: {len(data)} of {declared} bytes",
                str(self.path),
                "copy or export it again",
            )
        if int.from_bytes(data[4:8], "little") == 1:
            raise self._old("1")
        position = 12
        while position + 8 <= declared:
            size = int.from_bytes(data[position : position + 4], "little")
            kind = data[position + 4 : position + 8]
            content = data[position + 8 : position + 8 + size]
            if kind == b"JSON":
                text = content.rstrip(b"\0")  # blanks by the specification
            elif kind == b"BIN\0":
                self.binary = content
            position += 8 + size
        return text

    def buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            entry = self.entry("buffers", index)
            uri = entry.get("uri")
            content = self.binary if uri is None else self._referenced(uri)
            if len(content) < entry["byteLength"] and "extensions" in entry:
                by = printable(", ".join(entry["extensions"]))
                raise ScanError(
                    f"{self.path.name} is compressed by {by}, which is not supported",
                    str(self.path),
                    "export it uncompressed, or with Draco",
                )
            if len(content) < entry["byteLength"]:
                raise ScanError(
                    f"{self.path.name}: buffer {index} is cut short",
                    str(self.path),
                    "copy all its files again",
                )
            self._buffers[index] = content
        return self._buffers[index]

    def view(self, index: int) -> bytes:
        entry = self.entry("bufferViews", index)
        start, size = entry.get("byteOffset", 0), entry["byteLength"]
        content = self.buffer(entry["buffer"])
        if start < 0 or size < 0 or start + size > len(content):
            raise self.broken("a buffer view leaves its buffer")
        return content[start : start + size]

    def broken(self, what: str) -> ScanError:
        return ScanError(f"{self.path.name}: {what}", str(self.path), "copy or export it again")

    def accessor(self, index: int) -> npt.NDArray[Any]:
        """(count, width) values; normalised integers become floats; sparse ones are filled in."""
        entry = self.entry("accessors", index)
        width, count = _WIDTH[entry["type"]], entry["count"]
        dtype = np.dtype(_COMPONENT[entry["componentType"]])
        # Elements without bytes in the file are zeros, which only sparse accessors have a use for.
        if count < 0 or ("bufferView" not in entry and count * width > _MOST_ZEROS):
            raise ScanError(
                f"{self.path.name} says that it has {count} elements where it has no data",
                str(self.path),
                "export it again",
            )
        if "bufferView" in entry:
            values = self._strided(entry, dtype, width)
        else:
            values = np.zeros((count, width), dtype)
        if "sparse" in entry:
            values = self._sparse(entry["sparse"], values, dtype, width)
        if entry.get("normalized") and dtype.kind in "iu":
            limit = float(np.iinfo(dtype).max)
            return np.asarray(np.maximum(values.astype(np.float32) / limit, -1.0))
        return np.asarray(values)

    def _strided(self, entry: dict[str, Any], dtype: np.dtype[Any], width: int) -> npt.NDArray[Any]:
        view = self.entry("bufferViews", entry["bufferView"])
        content = self.view(entry["bufferView"])
        offset, count = entry.get("byteOffset", 0), entry["count"]
        stride = view.get("byteStride") or dtype.itemsize * width
        last = offset + stride * (count - 1) + dtype.itemsize * width
        if count and (offset < 0 or stride < 0 or last > len(content)):
            raise self.broken("an accessor leaves its buffer")
        return np.ndarray((count, width), dtype, content, offset, (stride, dtype.itemsize)).copy()

    def _sparse(
        self, sparse: dict[str, Any], values: npt.NDArray[Any], dtype: np.dtype[Any], width: int
    ) -> npt.NDArray[Any]:
        count = sparse["count"]
        where, what = sparse["indices"], sparse["values"]
        index = np.frombuffer(
            self.view(where["bufferView"]),
            _COMPONENT[where["componentType"]],
            count,
            where.get("byteOffset", 0),
        )
        new = np.frombuffer(
            self.view(what["bufferView"]), dtype, count * width, what.get("byteOffset", 0)
        )
        if count and not 0 <= int(index.min()) <= int(index.max()) < len(values):
            raise self.broken("a sparse accessor names elements that it does not have")
        values = values.copy()
        values[index] = new.reshape(count, width)
        return values

    def page(self, texture: int, encoding: Encoding, notes: list[str]) -> Page | None:
        """The image of a texture, or None (with a note) when it is missing or not decodable."""
        entry = self.entry("textures", texture)
        webp = entry.get("extensions", {}).get("EXT_texture_webp", {}).get("source")
        source = webp if webp is not None else entry.get("source")
        if source is None:
            notes.append("a texture has no PNG, JPEG or WebP image: it is ignored")
            return None
        if (source, encoding) not in self._pages:
            self._pages[source, encoding] = self._image(source, encoding, notes)
        return self._pages[source, encoding]

    def _image(self, source: int, encoding: Encoding, notes: list[str]) -> Page | None:
        image = self.entry("images", source)
        name = printable(image.get("name") or f"image {source}")
        uri = image.get("uri", "")
        if "bufferView" not in image and not uri.startswith("data:"):
            file = self._beside(uri)
            if file is None:
                notes.append(f"the image {printable(uri)} is missing")
                return None
            return read_page(file, encoding, printable(file.name))
        content = self.view(image["bufferView"]) if "bufferView" in image else self._referenced(uri)
        return self._decoded(content, name, encoding, notes)

    def _beside(self, uri: str) -> Path | None:
        """The file of that name, or of what is left without a query (`?v=2`) or fragment."""
        plain = re.split("[?#]", uri, maxsplit=1)[0]
        names = dict.fromkeys((uri, plain))
        found = (inside(self.path.parent, name, self.path) for name in names)
        return next((file for file in found if file is not None), None)

    def _decoded(
        self, content: bytes, name: str, encoding: Encoding, notes: list[str]
    ) -> Page | None:
        suffix = {b"\x89PNG": ".png", b"\xff\xd8\xff": ".jpg", b"RIFF": ".webp"}
        kind = next((s for magic, s in suffix.items() if content.startswith(magic)), None)
        if kind is None:
            notes.append(f"{name} is neither PNG, JPEG nor WebP: it is ignored")
            return None
        # OpenImageIO's Python binding reads files only, so the bytes pass through one.
        with tempfile.TemporaryDirectory(prefix="scanrender-") as folder:
            file = Path(folder) / f"image{kind}"
            file.write_bytes(content)
            return read_page(file, encoding, name)

    def _referenced(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            try:
                return base64.b64decode(unquote(uri.partition(",")[2]))
            except ValueError as error:
                raise self.broken("embedded data is not base64") from error
        file = self._beside(uri)
        if file is None:
            raise ScanError(
                f"{self.path.name} needs {printable(uri)}, which is missing",
                str(self.path),
                "copy it too",
            )
        return file.read_bytes()
