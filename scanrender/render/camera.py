"""Cameras: framing the subject, the guard band, and the matrices of one sample.

Matrices are 4x4 float64, named `target_from_source`, for column vectors. World: millimetres, +Y up,
the subject faces +Z, its centre at the origin. View: the camera looks along -Z. Clip: OpenGL's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

from scanrender.settings.shot import CameraSettings

Matrix = npt.NDArray[np.float64]
SENSOR_HEIGHT_MM = 24.0
# Far over near plane beyond which the depth buffer holds depth itself, not its reciprocal: 24 bits
# of that are then coarser than a thousandth of the depth, and what lies behind comes through.
LINEAR_DEPTH_FROM = 1e4
# Chin to crown, adults: 227 mm (the close view of the published timings).
HALF_HEAD_MM = 113.5


@dataclass(frozen=True)
class Camera:
    """A camera around `target_mm`. `size_px` and `half_height` exclude the guard band.

    `half_height` is half of the picture's height: a tangent (mm at 1 mm) in perspective, mm at any
    depth when orthographic. `centre_px` is where the picture's centre lies from the optical axis,
    (right, down): not 0 when the picture is a window cut out of a larger one.
    """

    size_px: tuple[int, int]
    half_height: float
    is_orthographic: bool
    azimuth_deg: float
    elevation_deg: float
    distance_mm: float
    target_mm: npt.NDArray[np.float64]
    near_mm: float
    far_mm: float
    centre_px: tuple[float, float] = (0.0, 0.0)

    @property
    def view_from_world(self) -> Matrix:
        turn = rotation_x(self.elevation_deg) @ rotation_y(-self.azimuth_deg)
        move = np.eye(4)
        move[:3, 3] = -self.target_mm
        back = np.eye(4)
        back[2, 3] = -self.distance_mm
        return back @ turn @ move

    def turned(self, degrees: float) -> Camera:
        """The same camera, further around the subject."""
        return replace(self, azimuth_deg=self.azimuth_deg + degrees)

    def window(self, shares: tuple[float, float, float, float]) -> Camera:
        """The same camera that shows only (left, top, right, bottom) of its picture, as shares.

        The window is whole pixels of that picture, at least one: what it shows is a crop of it.
        """
        spans = []
        for low, high, side in zip(shares[:2], shares[2:], self.size_px, strict=True):
            start = min(int(low * side + 1e-6), side - 1)
            spans.append((start, max(int(high * side + 1e-6), start + 1)))
        (left, right), (top, bottom) = spans
        width, height = self.size_px
        x, y = self.centre_px
        return replace(
            self,
            size_px=(right - left, bottom - top),
            half_height=self.half_height * (bottom - top) / height,
            centre_px=(x + 0.5 * (left + right - width), y + 0.5 * (top + bottom - height)),
        )

    def halved(self) -> Camera:
        """The same camera with pixels twice as wide, around the same middle; one more where the
        number was odd."""
        width, height = ((side + 1) // 2 for side in self.size_px)
        return replace(
            self,
            size_px=(width, height),
            half_height=self.half_height * 2 * height / self.size_px[1],
            centre_px=(0.5 * self.centre_px[0], 0.5 * self.centre_px[1]),
        )

    def clip_from_view(self, guard_px: int = 0, jitter_px: tuple[float, float] = (0, 0)) -> Matrix:
        """Projection with `guard_px` more pixels on each side, moved by a sub-pixel jitter.

        Jitter is (right, down) of the sample inside its pixel, 0 at the centre.
        """
        width, height = self.size_px
        tall, wide = height + 2 * guard_px, width + 2 * guard_px
        right, down = self.centre_px[0] + jitter_px[0], self.centre_px[1] + jitter_px[1]
        p11 = 1.0 / (self.half_height * tall / height)
        near, far = self.near_mm, self.far_mm
        matrix = np.zeros((4, 4))
        if self.is_orthographic:
            matrix[0, 0], matrix[1, 1] = p11 * tall / wide, p11
            matrix[0, 3], matrix[1, 3] = -2.0 * right / wide, 2.0 * down / tall
            matrix[2, 2], matrix[2, 3] = -2.0 / (far - near), -(far + near) / (far - near)
            matrix[3, 3] = 1.0
            return matrix
        matrix[0, 0] = p11 * tall / wide  # square pixels
        matrix[1, 1] = p11
        # A sample right of the pixel's centre sees what a picture moved left would show there.
        matrix[0, 2] = 2.0 * right / wide
        matrix[1, 2] = -2.0 * down / tall
        matrix[2, 2:] = depth_rows(near, far)
        matrix[3, 2] = -1.0
        return matrix

    def px_per_mm(self, depth_mm: float) -> float:
        """Pixels per millimetre at a depth: 0.5 H P11 / z, square pixels, ortho without /z."""
        scale = 0.5 * self.size_px[1] / self.half_height
        return scale if self.is_orthographic else scale / depth_mm


def bounding_radius_mm(positions_mm: npt.NDArray[np.floating]) -> float:
    """Of the sphere around the origin that holds everything; never nothing, for a single point."""
    return float(np.linalg.norm(positions_mm, axis=1).max(initial=1e-6))


def frame_subject(
    settings: CameraSettings,
    positions_mm: npt.NDArray[np.floating],
    turn_angles_deg: npt.NDArray[np.floating],
) -> Camera:
    """A camera that shows `height_mm` of the subject, or all of it at every turn angle.

    Without `height_mm` it is the nearest camera (the narrowest view, if orthographic) that keeps
    every vertex inside `fill` of the picture.
    """
    aim = float(np.max(positions_mm[:, 1])) - HALF_HEAD_MM if settings.aim == "head" else 0.0
    target = np.array([0.0, aim + settings.look_up_mm, 0.0])
    points = _outermost(np.asarray(positions_mm, dtype=np.float64) - target)
    radius = bounding_radius_mm(points)
    is_orthographic = settings.projection == "orthographic"
    # Well in front of the whole subject: parallel rays see the same from anywhere, and a triangle
    # thinner than the rasteriser's grid is drawn as far off as it is deep.
    half_height, distance = 0.5 * SENSOR_HEIGHT_MM / settings.focal_mm, 8.0 * radius
    if is_orthographic:
        half_height = _half_height_mm(settings, points, turn_angles_deg, radius)
    elif settings.height_mm is not None:
        distance = 0.5 * settings.height_mm / half_height
    else:
        distance = _distance_mm(settings, points, turn_angles_deg, half_height)
        distance = max(distance, radius * (1.02 if settings.fill <= 1 else 0.05))
    return Camera(
        size_px=(settings.width_px, settings.height_px),
        half_height=half_height,
        is_orthographic=is_orthographic,
        azimuth_deg=settings.azimuth_deg,
        elevation_deg=settings.elevation_deg,
        distance_mm=distance,
        target_mm=target,
        near_mm=max(distance - 1.05 * radius, distance * 1e-3),
        far_mm=distance + 1.05 * radius,
    )


def _distance_mm(
    settings: CameraSettings, points: Matrix, angles_deg: npt.NDArray[np.floating], tan: float
) -> float:
    """The nearest perspective: (x, y, z) in the camera's axes fits when |y| <= tan (D - z)."""
    distance = 0.0
    for x, y, z in _turned(settings, points, angles_deg):
        distance = max(distance, float((z + _reach(settings, x, y) / tan).max()))
    return distance


def _half_height_mm(
    settings: CameraSettings,
    points: Matrix,
    angles_deg: npt.NDArray[np.floating],
    radius: float,
) -> float:
    """Half the height that an orthographic picture shows; never nothing, for a single point."""
    if settings.height_mm is not None:
        return 0.5 * settings.height_mm
    turned = _turned(settings, points, angles_deg)
    widest = max(float(_reach(settings, x, y).max()) for x, y, _ in turned)
    return max(widest, 1e-3 * radius)


def _turned(
    settings: CameraSettings, points: Matrix, angles_deg: npt.NDArray[np.floating]
) -> Iterator[Matrix]:
    """(3, n) points in the camera's axes around the target, at each turn angle."""
    for angle in np.unique(np.round(angles_deg, 3)):
        turn = rotation_x(settings.elevation_deg) @ rotation_y(angle - settings.azimuth_deg)
        yield (points @ turn[:3, :3].T).T


def _reach(settings: CameraSettings, x: Matrix, y: Matrix) -> Matrix:
    """Half the picture's height, at the vertex, that just holds it inside `fill`."""
    wide = np.abs(x) * settings.height_px / settings.width_px
    return np.asarray(np.maximum(wide, np.abs(y)) / settings.fill)


def _outermost(points: Matrix) -> Matrix:
    """The corners of the convex hull: how far a vertex reaches is a maximum of linear functions."""
    if len(points) < 1000:
        return points
    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:  # a flat subject has no hull
        return points


def depth_rows(near: float, far: float) -> tuple[float, float]:
    """z of the clip space over (z, 1) of the view's; beyond LINEAR_DEPTH_FROM without a far plane,
    which float32 could not tell from what lies before it."""
    if far > LINEAR_DEPTH_FROM * near:
        return -1.0, -2.0 * near
    return -(far + near) / (far - near), -2.0 * far * near / (far - near)


def linear_depth(clip_from_view: Matrix, far: float) -> dict[str, tuple[float, float]]:
    """`depth_range_mm` (near plane, what lies beyond it) where the depth buffer is linear, else
    nothing: the uniform of `linear_depth.glsl`, for a matrix made with `depth_rows`."""
    if clip_from_view[3, 2] == 0.0 or clip_from_view[2, 2] != -1.0:
        return {}
    near = -0.5 * float(clip_from_view[2, 3])
    return {"depth_range_mm": (near, far - near)}


def rotation_y(degrees: float) -> Matrix:
    c, s = _cos_sin(degrees)
    return np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1.0]])


def rotation_x(degrees: float) -> Matrix:
    c, s = _cos_sin(degrees)
    return np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])


def _cos_sin(degrees: float) -> tuple[float, float]:
    angle = np.deg2rad(degrees)
    return float(np.cos(angle)), float(np.sin(angle))
