"""Light from all around: convolutions on the sphere against their closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanrender.errors import ConfigError
from scanrender.optics.environment import (
    directions,
    filtered,
    irradiance_kernel,
    lobe_kernel,
    resampled,
    solid_angles,
)
from scanrender.optics.surface import SpecularLobes, rho_dt

COSINES = np.array([0.0, 1.0])
LAMBERT = irradiance_kernel(COSINES, np.zeros(2))


def test_the_middle_is_the_front_and_the_top_is_up():
    toward = directions(64, 128)
    np.testing.assert_allclose(np.linalg.norm(toward, axis=-1), 1.0)
    middle = toward[31:33, 63:65].mean(axis=(0, 1))
    np.testing.assert_allclose(middle, [0, 0, 1], atol=1e-3)
    assert (toward[0, :, 1] > 0.99).all()
    # Seen from inside, looking along +Z: +X is on the left.
    assert toward[32, 32, 0] > 0.99


@pytest.mark.parametrize(("rows", "columns"), [(1, 2), (7, 20), (256, 512)])
def test_texels_cover_the_sphere(rows: int, columns: int):
    assert solid_angles(rows, columns).sum() * columns == pytest.approx(4 * np.pi)


@given(
    st.integers(0, 99), st.tuples(st.integers(1, 40), st.integers(1, 60)),
    st.tuples(st.integers(1, 30), st.integers(1, 50)),
)  # fmt: skip
def test_another_size_holds_the_same_light(seed: int, size, new_size):
    picture = np.random.default_rng(seed).exponential(size=(*size, 3)) ** 3
    small = resampled(picture, *new_size)
    assert small.shape == (*new_size, 3)

    def light(p):
        return np.einsum("h,hwk->k", solid_angles(*p.shape[:2]), p)

    np.testing.assert_allclose(light(small), light(picture), rtol=1e-9)
    assert small.min() >= picture.min() - 1e-9
    assert small.max() <= picture.max() + 1e-9


def test_the_same_size_is_the_same_picture():
    picture = np.random.default_rng(0).random((16, 32, 3))
    np.testing.assert_allclose(resampled(picture, 16, 32), picture, atol=1e-12)


def test_constant_light_gives_irradiance_one_less_what_is_reflected():
    picture = np.ones((128, 256, 3)) * [1.0, 2.0, 0.5]
    plain = filtered(picture, LAMBERT, 8, normalized=False)
    np.testing.assert_allclose(plain, np.broadcast_to([1.0, 2.0, 0.5], plain.shape), rtol=2e-4)
    cosines = (np.arange(64) + 0.5) / 64
    rho = SpecularLobes(0.3, 0.3, 1.0, 0.2).directional_albedo(cosines)
    entering = filtered(picture, irradiance_kernel(cosines, rho), 4, normalized=False)
    np.testing.assert_allclose(entering[..., 0], 1 - np.average(rho, weights=cosines), rtol=1e-3)


def test_a_linear_sky_keeps_two_thirds_of_its_slope():
    """Ramamoorthi & Hanrahan 2001: order 1 is scaled by 2/3, order 2 by 1/4, order 3 by 0."""
    toward = directions(128, 256)
    x, y, z = toward[..., 0], toward[..., 1], toward[..., 2]
    normal = directions(32, 256)
    nx, ny, nz = normal[..., 0], normal[..., 1], normal[..., 2]
    cases = [
        (1 + 0.5 * y, 1 + ny / 3),
        (1 + 0.5 * x, 1 + nx / 3),
        (1 + 0.4 * (3 * z * z - 1), 1 + 0.1 * (3 * nz * nz - 1)),
        (2 + 0.5 * (5 * y**3 - 3 * y), 2 + 0 * ny),
    ]
    for sky, expected in cases:
        found = filtered(sky[:, :, None], LAMBERT, 32, normalized=False)[..., 0]
        np.testing.assert_allclose(found, expected, atol=3e-4)


@pytest.mark.parametrize("row", [3, 40, 64, 120])
def test_one_bright_texel_is_a_directional_light(row: int):
    picture = np.zeros((128, 256, 1))
    # Irradiance 1, in units of pi, on what faces it.
    picture[row, 200] = np.pi / solid_angles(128, 256)[row]
    cosine = directions(64, 256) @ directions(128, 256)[row, 200]
    found = filtered(picture, LAMBERT, 64, normalized=False)[..., 0]
    np.testing.assert_allclose(found, np.maximum(cosine, 0.0), atol=1e-9)


@pytest.mark.parametrize("m", [0.01, 0.05, 0.15, 0.3, 1.0])
def test_a_lobe_leaves_constant_light_and_looks_where_the_mirror_looks(m: float):
    rows = 128 if m < 0.05 else 64
    constant = filtered(np.ones((rows, 2 * rows, 1)), lobe_kernel(m, 0.028), 16, normalized=True)
    np.testing.assert_allclose(constant, 1.0, rtol=1e-12)
    sun = np.zeros((rows, 2 * rows, 1))
    sun[rows // 3, rows // 2] = 1.0
    seen = filtered(sun, lobe_kernel(m, 0.028), rows, normalized=True)[..., 0]
    if m < 1:  # the widest lobe is brightest beside the mirror direction
        assert np.unravel_index(seen.argmax(), seen.shape) == (rows // 3, rows // 2)
    assert seen.min() >= 0


def test_lobes_as_wide_as_they_say():
    """The kernel's mean over the sphere is what the surface reflects straight back."""
    for m in (0.1, 0.3, 0.6):
        cosine, weight = np.polynomial.legendre.leggauss(400)
        integral = 2 * np.pi * float(weight @ lobe_kernel(m, 0.05)(cosine))
        assert integral == pytest.approx(float(rho_dt(1.0, m, 0.05)), rel=1e-3)


def test_a_lobe_that_meets_no_texel_is_said():
    with pytest.raises(ConfigError, match="narrower"):
        filtered(np.ones((4, 8, 1)), np.zeros_like, 4, normalized=True)


@settings(max_examples=10)
@given(st.integers(0, 99), st.sampled_from([1e-8, 1.0, 1e8]))
def test_light_is_linear_and_never_negative(seed: int, factor: float):
    picture = np.random.default_rng(seed).exponential(size=(16, 32, 3)) ** 4
    once = filtered(picture, LAMBERT, 8, normalized=False)
    np.testing.assert_allclose(filtered(picture * factor, LAMBERT, 8, normalized=False),
                               once * factor, rtol=1e-9)  # fmt: skip
    assert (once >= 0).all()
    # Turning the picture turns what it lights.
    turned = filtered(np.roll(picture, 5, axis=1), LAMBERT, 8, normalized=False)
    np.testing.assert_allclose(turned, np.roll(once, 5, axis=1), rtol=1e-9)
