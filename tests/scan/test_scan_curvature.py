"""Mean curvature against closed forms, by the bake's own stages: any triangulation, unit, noise.

The whole table of errors: `python -m tests.scan.curvature_table`.
"""

from __future__ import annotations

import numpy as np
import pytest
from curvature_table import (
    KINDS,
    NOISE_MM,
    RADII,
    SHAPES,
    baked_curvature,
    noise_case,
    rms_share,
    sphere,
)
from scan_shapes import write_ply

from scanrender.scan.curvature import curvature_scale, mean_curvature, noise_level
from scanrender.scan.diffuse import cotangent_laplacian, faired
from scanrender.scan.pages import Page
from scanrender.scan.prepare import prepare
from scanrender.scan.topology import area_normals, unit
from scanrender.settings.prep import BakeSettings, PrepSettings, SimplifySettings
from scanrender.settings.scan import ScanSettings


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("radius", RADII)
@pytest.mark.parametrize("name", SHAPES)
def test_every_shape_size_and_triangulation(name, radius, kind):
    made = SHAPES[name](radius, radius / 10, np.random.default_rng(1), kind)
    error, _ = rms_share(made, 1.0 / radius)
    assert error < 0.02


@pytest.mark.parametrize("kind", ["shaken", "random"])
@pytest.mark.parametrize("name", SHAPES)
def test_finer_meshes_are_no_worse(name, kind):
    made = SHAPES[name](20.0, 20.0 / 25, np.random.default_rng(1), kind)
    error, _ = rms_share(made, 1.0 / 20.0)
    assert error < 0.02


@pytest.mark.parametrize("unit", ["cm", "m"])
@pytest.mark.parametrize("name", SHAPES)
def test_units_do_not_matter(name, unit):
    made = SHAPES[name](20.0, 2.0, np.random.default_rng(2), "random")
    in_mm, scale = baked_curvature(made, "mm")
    other, other_scale = baked_curvature(made, unit)
    assert other_scale == pytest.approx(scale, rel=1e-3)
    np.testing.assert_allclose(other, in_mm, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("radius", [20.0, 100.0])
def test_scanner_noise_of_a_tenth_of_a_millimetre_at_edges_of_one(radius, kind):
    made = noise_case(radius, kind)
    assert noise_level(made.positions, made.faces) == pytest.approx(NOISE_MM, rel=0.45)
    error, scale = rms_share(made, 1.0 / radius)
    assert error < 0.1
    assert scale < 5.0, "blurred away, any noise would pass"
    untreated = mean_curvature(made.positions, made.faces, 1.0)
    assert np.std(untreated[made.inner]) * radius > 0.3, "otherwise the noise was no test"


def test_fairing_takes_noise_out_of_slopes_and_hardly_shrinks():
    rng = np.random.default_rng(3)
    clean = sphere(20.0, 1.0, rng, "shaken")
    noisy = clean.positions * (1.0 + rng.normal(0.0, 0.005, (len(clean.positions), 1)))
    smooth = faired(noisy, clean.faces, 0.7, cotangent_laplacian(noisy, clean.faces))

    def slope(positions):
        normal = unit(area_normals(positions, clean.faces))
        outward = unit(positions[clean.faces].mean(axis=1))
        return np.sqrt(np.mean(1.0 - np.einsum("ij,ij->i", normal, outward) ** 2))

    assert slope(smooth) < 0.5 * slope(noisy)
    radius = np.linalg.norm(smooth, axis=1)
    assert radius.mean() == pytest.approx(20.0 - 0.7**2 / 20.0, abs=0.01)


def test_the_laplacian_has_no_negative_energy_and_leaves_linear_functions_alone():
    rng = np.random.default_rng(5)
    made = SHAPES["saddle"](20.0, 5.0, rng, "stretched")
    flat = made.positions * [1.0, 1.0, 0.0]
    flat[::7, :2] += rng.normal(0.0, 0.4, (len(flat[::7]), 2))  # folds and slivers
    stiffness = cotangent_laplacian(flat, made.faces)
    lowest = np.linalg.eigvalsh(stiffness.toarray()).min()
    assert lowest > -1e-9
    straight = cotangent_laplacian(made.positions * [1.0, 1.0, 0.0], made.faces) @ (
        made.positions[:, :2] @ [0.3, -0.7]
    )
    assert np.abs(straight[made.inner]).max() < 1e-9


def test_the_scale_grows_with_noise_and_coarseness_only():
    rng = np.random.default_rng(4)
    fine = sphere(20.0, 0.8, rng, "shaken")
    coarse = sphere(20.0, 3.0, rng, "shaken")
    assert curvature_scale(fine.positions, fine.faces, 2.5) == 2.5
    assert curvature_scale(coarse.positions, coarse.faces, 2.5) == pytest.approx(6.0, rel=0.1)
    noisy = fine.positions * (1.0 + rng.normal(0.0, 0.1 / 20.0, (len(fine.positions), 1)))
    assert curvature_scale(noisy, fine.faces, 2.5) > 3.0


def test_the_map_of_an_asset_holds_it_too(tmp_path):
    """From a file in cm to the EXR, read back at every face of the prepared mesh."""
    made = sphere(60.0, 3.0, np.random.default_rng(6), "random")
    scan = write_ply(tmp_path / "ball.ply", made.positions / 10.0, made.faces)
    bake = BakeSettings(data_px=256, albedo_px=256, maps=("curvature",))
    prep = PrepSettings(simplify=SimplifySettings(triangles=1200), bake=bake, report="short")
    asset = prepare(scan, ScanSettings(units="cm"), prep, tmp_path / "asset")
    middle = asset.mesh.uv[asset.mesh.faces].mean(axis=1)
    baked = np.repeat(asset.maps["curvature"][:, :, :1], 3, axis=2)
    found = Page("curvature", baked, "linear").sample(middle)[:, 0]
    error = found * 60.0 - 1.0
    assert len(error) > 1000
    assert np.sqrt(np.mean(error**2)) < 0.02
