"""Points of the surface that a picture shows, found by rays of the camera.

Matrices are 4x4 float64, `target_from_source`, for column vectors, as the renderer's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from scanrender.optics._math import Array
from scanrender.reference.rays import Faces, Flags
from scanrender.reference.surface import Surface, unit
from scanrender.settings.light import Follows

# Hidden by less than this along the ray is the surface itself, mm.
_ITSELF_MM = 0.05


@dataclass(frozen=True)
class PictureCamera:
    """How one frame is looked at: OpenGL's matrices, (width, height), offsets of the samples.

    ``clip_from_view`` is that of the picture without guard band or jitter; ``offsets_px`` are
    (right, down) of each supersample from the pixel's centre. Of rows and columns only each
    ``every_px``-th is looked at: a large picture is judged by a grid of its own pixels.
    """

    view_from_world: Array
    world_from_object: Array
    clip_from_view: Array
    size_px: tuple[int, int]
    offsets_px: Sequence[tuple[float, float]] = ((0.0, 0.0),)
    every_px: int = 1

    @property
    def view_from_object(self) -> Array:
        """4x4."""
        return np.asarray(self.view_from_world @ self.world_from_object)

    @property
    def is_orthographic(self) -> bool:
        """Whether rays are parallel."""
        return bool(self.clip_from_view[3, 2] == 0.0)

    @property
    def px_per_mm_at_1mm(self) -> float:
        """0.5 H P11: pixels per mm at a depth of 1 mm; at any depth if orthographic."""
        return float(0.5 * self.size_px[1] * self.clip_from_view[1, 1])

    @property
    def eye(self) -> Array:
        """(3,) in object space, mm; meaningless when orthographic."""
        return np.asarray(np.linalg.inv(self.view_from_object)[:3, 3])

    def to_eye(self, position: Array) -> Array:
        """(k, 3) unit vectors in object space from positions (k, 3)."""
        if self.is_orthographic:
            back = np.asarray(np.linalg.inv(self.view_from_object)[:3, 2], np.float64)
            return np.broadcast_to(unit(back), position.shape)
        return unit(self.eye - position)

    def object_from_rig(self) -> dict[Follows, Array]:
        """Rotations (3, 3) from what each light may be fixed to (`Shot.rig_from_world`)."""
        object_from_world = np.asarray(np.linalg.inv(self.world_from_object)[:3, :3], np.float64)
        camera = np.asarray(object_from_world @ self.view_from_world[:3, :3].T, np.float64)
        return {"world": object_from_world, "subject": np.eye(3), "camera": camera}

    def rays(self, column: Array, row: Array) -> tuple[Array, Array, Array]:
        """Origins and unit directions (k, 3) in object space through (column, row) px, and reaches.

        Columns count from the left edge and rows from the top edge of the picture; a pixel's
        centre is at half a pixel.
        """
        width, height = self.size_px
        x, y = 2.0 * column / width - 1.0, 1.0 - 2.0 * row / height
        object_from_clip = np.linalg.inv(self.clip_from_view @ self.view_from_object)
        ends = []
        for z in (-1.0, 1.0):
            clip = np.stack([x, y, np.full_like(x, z), np.ones_like(x)], axis=1)
            end = clip @ object_from_clip.T
            ends.append(end[:, :3] / end[:, 3:])
        reach = np.linalg.norm(ends[1] - ends[0], axis=1)
        return ends[0], unit(ends[1] - ends[0]), reach


@dataclass(frozen=True)
class Points:
    """k points of the surface that a picture shows.

    ``face`` (k,), ``bary`` (k, 3), ``is_inside`` (k,) where the back of the surface is seen;
    ``pixel`` (k,) is row x width + column.
    """

    face: Faces
    bary: Array
    is_inside: Flags
    pixel: npt.NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.face)

    def chosen(self, which: npt.NDArray[np.bool_] | npt.NDArray[np.int64]) -> Points:
        """Some of the points."""
        return Points(self.face[which], self.bary[which], self.is_inside[which], self.pixel[which])


def camera_points(surface: Surface, camera: PictureCamera) -> Points:
    """The points that the supersamples of the pixels show; a sample that misses has none."""
    width, height = camera.size_px
    rows, columns = np.divmod(np.arange(width * height), width)
    first, step = camera.every_px // 2, camera.every_px
    looked_at = np.flatnonzero((rows % step == first) & (columns % step == first))
    column, row = columns[looked_at] + 0.5, rows[looked_at] + 0.5
    found = _shown(surface, camera, column, row, camera.offsets_px)
    return replace(found, pixel=looked_at[found.pixel])


def points_of_positions(surface: Surface, camera: PictureCamera, position: Array) -> Points:
    """The points that pixels (k,) of a G-buffer show, from its positions (k, 3) in view space, mm.

    The pixel's number is its place in ``position``. Positions that the ray misses are left out.
    """
    clip = np.column_stack([position, np.ones(len(position))]) @ camera.clip_from_view.T
    ndc = clip[:, :2] / clip[:, 3:]
    width, height = camera.size_px
    column, row = 0.5 * (ndc[:, 0] + 1.0) * width, 0.5 * (1.0 - ndc[:, 1]) * height
    return _shown(surface, camera, column, row, [(0.0, 0.0)])


def _shown(
    surface: Surface,
    camera: PictureCamera,
    column: Array,
    row: Array,
    offsets_px: Sequence[tuple[float, float]],
) -> Points:
    parts = []
    for right, down in offsets_px:
        origin, way, _ = camera.rays(column + right, row + down)
        face, bary = surface.caster.first_hit(origin, way)
        pixel = np.flatnonzero(face >= 0)
        face, bary = face[pixel], bary[pixel]
        turned = np.einsum("ki,ki->k", surface.face_normals[face], way[pixel]) > 0.0
        parts.append(Points(face, bary, turned, pixel))
    join = np.concatenate
    return Points(
        join([part.face for part in parts]),
        join([part.bary for part in parts]),
        join([part.is_inside for part in parts]),
        join([part.pixel for part in parts]),
    )


def seen_by(surface: Surface, camera: PictureCamera, face: Faces, bary: Array) -> Flags:
    """(k,) whether the camera sees the front of the surface there; the picture's frame is no limit.

    What lies outside the picture still scatters into it.
    """
    position = surface.positions_at(face, bary)
    normal, to_eye = surface.face_normals[face], camera.to_eye(position)
    result: Flags = np.asarray(np.einsum("ki,ki->k", normal, to_eye) > 0.0)
    front = np.flatnonzero(result)
    start = position[front] + _ITSELF_MM * to_eye[front]
    reach: float | Array = 1e30
    if not camera.is_orthographic:
        reach = np.linalg.norm(camera.eye - start, axis=1)
    result[front] = ~surface.caster.is_blocked(start, to_eye[front], reach)
    return result
