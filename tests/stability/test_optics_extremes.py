"""Kernels, profiles and lobes at the ends of their ranges: finite, not negative, sums of 1."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanrender.optics.environment import filtered, irradiance_kernel, lobe_kernel
from scanrender.optics.kernels import (
    discrete_gaussian_taps,
    disk_taps,
    falloff_per_mm2,
    footprint_taps,
    gaussian_taps,
    separable_artistic,
    separable_preintegrated,
)
from scanrender.optics.profiles import Burley, GaussianSum
from scanrender.optics.surface import SpecularLobes, kelemen_brdf, rho_dt


def powers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high).map(lambda e: 10.0**e)


@st.composite
def profiles(draw: st.DrawFn) -> GaussianSum | Burley:
    """Widths of 1e-4 to 100 mm, the widest channel up to 1e4 times the narrowest."""
    widest = draw(powers(-4, 2))
    ratio = draw(powers(0, 4))
    widths = (widest, max(widest / ratio**0.5, 1e-4), max(widest / ratio, 1e-4))
    if draw(st.booleans()):
        return Burley(widths)
    variances = sorted({w * w for w in widths})
    rows = [[float(v == w * w) for w in widths] for v in variances]
    return GaussianSum.normalized(variances, rows)


def is_sound(array: np.ndarray) -> bool:
    return bool(np.isfinite(array).all() and (array >= 0.0).all())


@given(samples=st.integers(1, 1023), extent=st.floats(0.5, 8.0))
def test_gaussian_taps(samples: int, extent: float):
    taps = gaussian_taps(samples, extent)
    assert is_sound(taps.weights)
    assert taps.weights.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_array_equal(taps.offsets_sigma, -taps.offsets_sigma[::-1])


@given(
    sigma=powers(-2, np.log10(4096.0)),
    radius=st.integers(1, 64),
    shift=st.floats(-0.5, 0.5),
    samples=st.integers(1, 16),
)
def test_whole_pixel_taps_have_no_negative_weight(
    sigma: float, radius: int, shift: float, samples: int
):
    for weights in (
        footprint_taps([0.0, sigma], radius, shift, samples),
        discrete_gaussian_taps([0.0, sigma], radius),
    ):
        assert is_sound(weights)
        np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-12)


def test_tables_as_the_passes_take_them_have_no_negative_weight():
    sigma_px = np.linspace(0.0, 4.0, 129)
    for radius in range(1, 14):
        assert is_sound(discrete_gaussian_taps(sigma_px, radius))
        for samples in (1, 2, 3, 4, 16):
            for shift in np.linspace(-0.5, 0.5, 17):
                assert is_sound(footprint_taps(sigma_px, radius, float(shift), samples))


@given(profile=profiles(), samples=st.integers(1, 1023), extent=powers(-6, 6))
def test_separable_kernels_and_their_falloff(profile, samples: int, extent: float):
    taps = separable_preintegrated(profile, samples, extent)
    assert is_sound(taps.weights)
    assert is_sound(taps.cell_mm)
    np.testing.assert_allclose(taps.weights.sum(axis=0), 1.0, atol=1e-12)
    some = taps.offsets_mm[:: max(1, samples // 16)]
    assert is_sound(falloff_per_mm2(profile, some))


@given(near=powers(-4, 3), far=powers(-4, 3), strength=st.floats(0, 1), samples=st.integers(1, 255))
def test_artistic_kernels(near: float, far: float, strength: float, samples: int):
    taps = separable_artistic([near] * 3, [far] * 3, [strength] * 3, samples, 3.0 * max(near, far))
    assert is_sound(taps.weights)
    np.testing.assert_allclose(taps.weights.sum(axis=0), 1.0, atol=1e-12)


@given(profile=profiles(), n=st.integers(1, 1023), inner=powers(-8, 4))
def test_disks(profile, n: int, inner: float):
    disk = disk_taps(profile, n, inner)
    assert is_sound(disk.weights)
    assert is_sound(disk.centre)
    assert is_sound(disk.radius_mm)
    assert (np.diff(disk.radius_mm) >= 0.0).all()
    np.testing.assert_allclose(disk.weights.sum(axis=0) + disk.centre, 1.0, atol=1e-12)


@given(profile=profiles(), factor=powers(-1.9, 2))
def test_profiles_are_free_of_units(profile, factor: float):
    scaled = (
        profile.scaled(factor)
        if isinstance(profile, GaussianSum)
        else Burley(tuple(factor * d for d in profile.scale_mm))
    )
    r = np.geomspace(1e-6, 1e6, 200)
    for name in ("cdf", "line_cdf", "transmittance"):
        mine, theirs = getattr(profile, name)(r), getattr(scaled, name)(r * factor)
        assert is_sound(mine)
        assert mine.max() <= 1.0 + 1e-12
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-12)
    assert (np.diff(profile.cdf(r), axis=0) >= -1e-15).all()
    assert (np.diff(profile.transmittance(r), axis=0) <= 1e-15).all()


@given(profile=profiles(), fraction=st.floats(0.0, 0.999999))
def test_radii_enclose_what_they_are_asked_for(profile, fraction: float):
    radius = profile.radius_for(fraction)
    assert is_sound(radius)
    for c in range(3):
        assert profile.cdf(radius[c])[c] == pytest.approx(fraction, abs=1e-9)


@given(m=st.floats(0.01, 1.0), f0=st.floats(0.0, 1.0), cosine=powers(-12, 0))
def test_lobes_reflect_no_more_than_arrives(m: float, f0: float, cosine: float):
    rho = rho_dt([0.0, cosine, 1.0], m, f0)
    assert is_sound(rho)
    assert rho.max() <= 1.0 + 1e-4


@given(
    m=st.floats(0.01, 1.0),
    light=st.tuples(*[st.floats(-1, 1)] * 3),
    view=st.tuples(*[st.floats(-1, 1)] * 3),
)
def test_reflection_is_finite_from_every_side(m: float, light, view):
    def unit(v):
        length = np.linalg.norm(v)
        return np.asarray(v) / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])

    assert is_sound(kelemen_brdf([0.0, 0.0, 1.0], unit(light), unit(view), m))
    assert is_sound(SpecularLobes(m, 1.0, 0.5).brdf([0.0, 0.0, 1.0], unit(light), -unit(light)))


@pytest.mark.parametrize("m", [0.01, 0.15, 1.0])
def test_environments_stay_light(m: float):
    picture = np.full((32, 64, 3), 1e-8)
    picture[5, 7] = 1e8  # a sun
    cosines = (np.arange(64) + 0.5) / 64
    for kernel, normalized in (
        (irradiance_kernel(cosines, np.zeros(64)), False),
        (lobe_kernel(m, 0.028), True),
    ):
        assert is_sound(filtered(picture, kernel, 16, normalized=normalized))
        constant = filtered(np.ones((32, 64, 3)), kernel, 16, normalized=normalized)
        np.testing.assert_allclose(constant, 1.0, rtol=2e-3)
