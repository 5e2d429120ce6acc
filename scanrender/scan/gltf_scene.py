"""The scene of a glTF: where each mesh stands, and how morph targets and its skin bend it.

Khronos glTF 2.0 specification, sections 3.5 (scenes and nodes), 3.7.2.2 (morph targets) and 3.7.3
(skins).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.errors import ScanError
from scanrender.scan.gltf_file import GltfFile

Array = npt.NDArray[Any]
_DEEPEST = 64
# Visited: nodes that share children multiply, and a few lines make 2^64.
_MOST_NODES = 100_000
_MOST_PRIMITIVES = 100_000


@dataclass(frozen=True)
class Instance:
    """A mesh of the scene. weights of its morph targets, empty where all are 0; matrix (4, 4) world
    from mesh; joints (j, 4, 4) world from mesh for each joint of its skin, or None."""

    mesh: int
    weights: tuple[float, ...]
    matrix: Array
    joints: Array | None


def instances(file: GltfFile) -> list[Instance]:
    """The meshes of the default scene. Raises ScanError for nodes without end and for more
    primitives, counted once for each node that shows them, than a scan can have."""
    nodes, scenes = file.json.get("nodes", []), file.json.get("scenes", [])
    if scenes:
        roots = file.entry("scenes", file.json.get("scene", 0)).get("nodes", [])
    else:
        children = {c for node in nodes for c in node.get("children", [])}
        roots = [i for i in range(len(nodes)) if i not in children]
    world: dict[int, Array] = {}
    found: list[tuple[dict[str, Any], Array]] = []
    visited = primitives = 0
    waiting = [(root, np.eye(4), 0) for root in reversed(roots)]
    while waiting:
        index, parent, depth = waiting.pop()
        visited += 1
        if depth > _DEEPEST or visited > _MOST_NODES:
            raise ScanError(
                f"{file.path.name}: its nodes form a loop", str(file.path), "export it again"
            )
        node = file.entry("nodes", index)
        matrix = world[index] = parent @ _local(node)
        if "mesh" in node:
            found.append((node, matrix))
            primitives += len(file.entry("meshes", node["mesh"]).get("primitives", []))
        if primitives > _MOST_PRIMITIVES:
            raise ScanError(
                f"{file.path.name} shows more than {_MOST_PRIMITIVES:,} meshes",
                str(file.path),
                "join them, or export a part",
            )
        waiting += [(child, matrix, depth + 1) for child in reversed(node.get("children", []))]
    return [
        Instance(node["mesh"], _weights(file, node), at, _joints(file, node, world))
        for node, at in found
    ]


def _weights(file: GltfFile, node: dict[str, Any]) -> tuple[float, ...]:
    stored = node.get("weights") or file.entry("meshes", node["mesh"]).get("weights") or ()
    weights = tuple(float(weight) for weight in stored)
    if not np.isfinite(weights).all():
        raise file.broken("its morph targets have weights that are not finite")
    return weights if any(weights) else ()


def morphed(
    file: GltfFile, primitive: Mapping[str, Any], positions: Array, weights: tuple[float, ...]
) -> Array:
    """Positions (n, 3) of a primitive moved by its morph targets."""
    for target, weight in zip(primitive.get("targets", ()), weights, strict=False):
        if weight and "POSITION" in target:
            moved = file.accessor(target["POSITION"])
            if moved.shape != positions.shape:
                raise file.broken("its morph targets do not fit its vertices")
            positions = positions + weight * moved
    return positions


def _joints(file: GltfFile, node: dict[str, Any], world: Mapping[int, Array]) -> Array | None:
    if "skin" not in node:
        return None
    skin = file.entry("skins", node["skin"])
    inverse = np.broadcast_to(np.eye(4), (len(skin["joints"]), 4, 4))
    if "inverseBindMatrices" in skin:
        stored = file.accessor(skin["inverseBindMatrices"]).astype(np.float64)
        inverse = stored.reshape(-1, 4, 4).transpose(0, 2, 1)[: len(skin["joints"])]
    # A joint outside the scene stays where its mesh was bound.
    pairs = zip(skin["joints"], inverse, strict=False)
    moved = [world[joint] @ bound if joint in world else np.eye(4) for joint, bound in pairs]
    return np.reshape(moved, (-1, 4, 4))


def skinned(part: Mapping[str, Array], joints: Array, path: Path) -> Array:
    """Positions (n, 3) in the scene, of positions, joints (n, 4) and weights (n, 4) of a mesh."""
    which = part["joints"]
    weight = np.maximum(part["weights"].astype(np.float64), 0.0)
    known = (which >= 0) & (which < len(joints))
    if which.dtype.kind not in "iu" or which.shape != weight.shape or not known.all():
        raise ScanError(
            f"{path.name}: its skin names joints that it does not have", str(path), "export again"
        )
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
    positions = part["positions"]
    out = np.zeros_like(positions)
    for column in range(which.shape[1]):
        matrix = joints[which[:, column]]
        moved = np.einsum("nij,nj->ni", matrix[:, :3, :3], positions) + matrix[:, :3, 3]
        out += weight[:, [column]] * moved
    return out


def _local(node: dict[str, Any]) -> Array:
    if "matrix" in node:
        return np.asarray(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.asarray(node.get("scale", (1.0, 1.0, 1.0)))
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix
