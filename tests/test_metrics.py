"""Metrics against published pairs, colour-science, and FLIP's own evaluator."""

from __future__ import annotations

import math
import warnings

import flip_evaluator
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanrender import metrics

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # colour-science warns about optional packages on import
    import colour

# Sharma, Wu & Dalal 2005, table 1, all 34 pairs: L a b, L a b, dE. Many sit where wrong hue
# averaging or a wrong sign of dh shows.
SHARMA = [
    (50.0, 2.6772, -79.7751, 50.0, 0.0, -82.7485, 2.0425),
    (50.0, 3.1571, -77.2803, 50.0, 0.0, -82.7485, 2.8615),
    (50.0, 2.8361, -74.0200, 50.0, 0.0, -82.7485, 3.4412),
    (50.0, -1.3802, -84.2814, 50.0, 0.0, -82.7485, 1.0000),
    (50.0, -1.1848, -84.8006, 50.0, 0.0, -82.7485, 1.0000),
    (50.0, -0.9009, -85.5211, 50.0, 0.0, -82.7485, 1.0000),
    (50.0, 0.0, 0.0, 50.0, -1.0, 2.0, 2.3669),
    (50.0, -1.0, 2.0, 50.0, 0.0, 0.0, 2.3669),
    (50.0, 2.4900, -0.0010, 50.0, -2.4900, 0.0009, 7.1792),
    (50.0, 2.4900, -0.0010, 50.0, -2.4900, 0.0010, 7.1792),
    (50.0, 2.4900, -0.0010, 50.0, -2.4900, 0.0011, 7.2195),
    (50.0, 2.4900, -0.0010, 50.0, -2.4900, 0.0012, 7.2195),
    (50.0, -0.0010, 2.4900, 50.0, 0.0009, -2.4900, 4.8045),
    (50.0, -0.0010, 2.4900, 50.0, 0.0010, -2.4900, 4.8045),
    (50.0, -0.0010, 2.4900, 50.0, 0.0011, -2.4900, 4.7461),
    (50.0, 2.5, 0.0, 50.0, 0.0, -2.5, 4.3065),
    (50.0, 2.5, 0.0, 73.0, 25.0, -18.0, 27.1492),
    (50.0, 2.5, 0.0, 61.0, -5.0, 29.0, 22.8977),
    (50.0, 2.5, 0.0, 56.0, -27.0, -3.0, 31.9030),
    (50.0, 2.5, 0.0, 58.0, 24.0, 15.0, 19.4535),
    (50.0, 2.5, 0.0, 50.0, 3.1736, 0.5854, 1.0000),
    (50.0, 2.5, 0.0, 50.0, 3.2972, 0.0, 1.0000),
    (50.0, 2.5, 0.0, 50.0, 1.8634, 0.5757, 1.0000),
    (50.0, 2.5, 0.0, 50.0, 3.2592, 0.3350, 1.0000),
    (60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644),
    (63.0109, -31.0961, -5.8663, 62.8187, -29.7946, -4.0864, 1.2630),
    (61.2901, 3.7196, -5.3901, 61.4292, 2.2480, -4.9620, 1.8731),
    (35.0831, -44.1164, 3.7933, 35.0232, -40.0716, 1.5901, 1.8645),
    (22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373),
    (36.4612, 47.8580, 18.3852, 36.2715, 50.5065, 21.2231, 1.4146),
    (90.8027, -2.0831, 1.4410, 91.1528, -1.6435, 0.0447, 1.4441),
    (90.9257, -0.5406, -0.9208, 88.6381, -0.8985, -0.7239, 1.5381),
    (6.7747, -0.2908, -2.4247, 5.8714, -0.0985, -2.2286, 0.6377),
    (2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082),
]
labs = st.tuples(st.floats(0, 100), st.floats(-128, 128), st.floats(-128, 128))


@pytest.mark.parametrize("row", SHARMA)
def test_published_pairs(row):
    assert float(metrics.delta_e_2000(row[:3], row[3:6])) == pytest.approx(row[6], abs=5.1e-5)


def test_agrees_with_colour_science():
    rng = np.random.default_rng(1)
    one = rng.uniform((0, -128, -128), (100, 128, 128), (20_000, 3))
    two = np.concatenate((one[:10_000] + rng.normal(0, 3, (10_000, 3)), one[:9_999:-1]))
    expected = colour.delta_E(one, two, method="CIE 2000")
    np.testing.assert_allclose(metrics.delta_e_2000(one, two), expected, atol=1e-9)


@given(labs, labs)
@settings(max_examples=100, deadline=None)
def test_delta_e_is_symmetric_finite_and_zero_for_equals(one, two):
    there = float(metrics.delta_e_2000(one, two))
    assert math.isfinite(there)
    assert there >= 0.0
    assert float(metrics.delta_e_2000(one, one)) == 0.0
    # exactly opposite hues are the formula's own discontinuity (Sharma, section 3)
    hues = [math.atan2(lab[2], lab[1]) for lab in (one, two)]
    if abs(abs(hues[0] - hues[1]) - math.pi) > 1e-6:
        assert there == pytest.approx(float(metrics.delta_e_2000(two, one)), abs=1e-9)


def test_lab_of_white_black_and_grey():
    lab = metrics.lab_from_linear_rec709([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0], [0.18, 0.18, 0.18]])
    np.testing.assert_allclose(lab, [[100, 0, 0], [0, 0, 0], [49.4961, 0, 0]], atol=1e-4)


def test_lab_agrees_with_colour_science():
    linear = np.random.default_rng(2).random((1000, 3))
    xyz = colour.RGB_to_XYZ(linear, "ITU-R BT.709", apply_cctf_decoding=False)
    # the published matrix is rounded to four digits, ours is exact
    np.testing.assert_allclose(
        metrics.lab_from_linear_rec709(linear), colour.XYZ_to_Lab(xyz), atol=0.01
    )


def test_lab_of_negative_light_is_finite():
    lab = metrics.lab_from_linear_rec709([-0.5, -1e-9, -20.0])
    assert np.all(np.isfinite(lab))
    assert lab[0] < 0.0


def test_srgb_decodes_like_colour_science():
    value = np.linspace(0.0, 1.0, 257)
    np.testing.assert_allclose(
        metrics.linear_from_srgb(value), colour.models.eotf_sRGB(value), atol=1e-6
    )
    np.testing.assert_array_equal(metrics.linear_from_srgb([-1.0, 2.0]), [0.0, 1.0])


def test_delta_e_of_linear_images_is_what_a_display_shows():
    over, white = np.full((1, 1, 3), 4.0), np.ones((1, 1, 3))
    assert metrics.delta_e_2000_linear(over, white)[0, 0] == 0.0
    grey = metrics.delta_e_2000_linear(0.5 * white, white)[0, 0]
    expected = float(metrics.delta_e_2000((76.0693, 0, 0), (100, 0, 0)))
    assert grey == pytest.approx(expected, abs=1e-3)


def images(kind: str) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    reference = rng.random((64, 71, 3))
    if kind == "noise":
        return np.clip(reference + rng.normal(0, 0.1, reference.shape), 0, 1), reference
    y, x = np.mgrid[0:64, 0:71]
    skin = np.stack((0.9 - 0.004 * x, 0.65 - 0.003 * y, 0.5 + 0.002 * (x - y)), axis=-1)
    if kind == "smooth":
        return np.clip(skin * 1.05, 0, 1), np.clip(skin, 0, 1)
    reference = np.where((x[..., None] // 9 + y[..., None] // 7) % 2 == 0, skin, 0.1)
    if kind == "edges":
        return np.roll(reference, 2, axis=1), reference
    return 1.0 - np.round(reference), np.round(reference)  # "extreme": cube corners only


@pytest.mark.parametrize("kind", ["noise", "smooth", "edges", "extreme"])
@pytest.mark.parametrize("ppd", [5.0, 20.0, metrics.DEFAULT_PPD, 120.0])
def test_flip_agrees_with_its_authors(kind, ppd):
    test, reference = images(kind)
    theirs, mean, _ = flip_evaluator.evaluate(
        reference.astype(np.float32), test.astype(np.float32), "LDR",
        applyMagma=False, parameters={"ppd": float(ppd)},
    )  # fmt: skip
    ours = metrics.flip(test, reference, ppd)
    theirs = np.asarray(theirs, dtype=np.float64).reshape(*ours.shape, -1)[..., 0]
    # theirs is float32, and where the images agree its rounding is raised to powers below 1:
    # a colour difference of 1e-5 becomes 1e-3. Everywhere else the maps are the same.
    off = np.abs(ours - theirs)
    assert float(np.quantile(off, 0.99)) < 2e-4
    assert float(off.max()) < 2e-3
    assert float(ours.mean()) == pytest.approx(mean, abs=1e-4)


@pytest.mark.parametrize("kind", ["noise", "edges", "extreme"])
def test_flip_is_symmetric_bounded_and_zero_for_equals(kind):
    test, reference = images(kind)
    there = metrics.flip(test, reference)
    np.testing.assert_array_equal(there, metrics.flip(reference, test))
    np.testing.assert_array_equal(metrics.flip(test, test), 0.0)
    assert there.min() >= 0.0
    assert there.max() <= 1.0
    assert there.max() > 0.05


def test_flip_sees_less_from_farther_away():
    test, reference = images("noise")
    near, far = (float(metrics.flip(test, reference, ppd).mean()) for ppd in (10.0, 100.0))
    assert near > 1.5 * far


def test_flip_of_an_image_smaller_than_its_filters():
    value = metrics.flip(np.zeros((1, 2, 3)), np.ones((1, 2, 3)))
    assert value.shape == (1, 2)
    assert np.all(value > 0.9)


def test_flip_shows_a_nan_instead_of_hiding_it():
    test, reference = images("smooth")
    test = test.copy()
    test[30, 30] = np.nan
    assert np.isnan(metrics.flip(test, reference)[30, 30])


@pytest.mark.parametrize("ppd", [0.0, -1.0, math.nan, math.inf])
def test_flip_needs_a_viewing_distance(ppd):
    with pytest.raises(ValueError, match="pixels per degree"):
        metrics.flip(np.zeros((4, 4, 3)), np.zeros((4, 4, 3)), ppd)


def test_errors_of_linear_light():
    reference = np.full((2, 2, 3), 2.0)
    image = reference.copy()
    image[0, 0] = [2.0, 2.0, 5.0]
    image[1, 1] = 100.0
    mask = np.array([[True, True], [False, False]])
    assert metrics.rmse(image, reference, mask) == pytest.approx(math.sqrt(9.0 / 6.0))
    assert metrics.rel_mse(image, reference, mask) == pytest.approx(9.0 / 4.01 / 6.0)
    np.testing.assert_allclose(metrics.energy_ratio(image, reference, mask), [1.0, 1.0, 7.0 / 4.0])
    assert metrics.rmse(image, reference) == pytest.approx(math.sqrt((9 + 3 * 98**2) / 12))


def test_rel_mse_of_black_is_finite():
    assert metrics.rel_mse(np.full((1, 1, 3), 0.1), np.zeros((1, 1, 3))) == pytest.approx(1.0)


def test_summary_counts_only_the_mask():
    values = np.arange(200.0).reshape(10, 20)
    mask = values < 101
    assert metrics.summarize(values, mask) == metrics.Summary(50.0, 95.0, 100.0, 101)
    assert metrics.summarize(values).count == 200


def test_no_pixels_is_not_a_perfect_score():
    nothing = np.zeros((2, 2), dtype=bool)
    summary = metrics.summarize(np.zeros((2, 2)), nothing)
    assert (summary.count, math.isnan(summary.mean), math.isnan(summary.maximum)) == (0, True, True)
    image = np.zeros((2, 2, 3))
    assert math.isnan(metrics.rmse(image, image, nothing))
    assert math.isnan(metrics.rel_mse(image, image, nothing))
    assert np.all(np.isnan(metrics.energy_ratio(image, image, nothing)))


def test_a_broken_pixel_is_not_averaged_away():
    image = np.zeros((3, 3, 3))
    image[1, 1, 1] = np.nan
    assert math.isnan(metrics.rmse(image, np.zeros((3, 3, 3))))
    assert math.isnan(metrics.summarize(image[..., 1]).maximum)
    assert math.isnan(metrics.summarize(image[..., 1]).p95)


@pytest.mark.parametrize(
    "call",
    [
        lambda: metrics.rmse(np.zeros((2, 2, 3)), np.zeros((2, 3, 3))),
        lambda: metrics.rmse(np.zeros((2, 2, 4)), np.zeros((2, 2, 4))),
        lambda: metrics.rmse(np.zeros((2, 2, 3)), np.zeros((2, 2, 3)), np.ones((3, 2), bool)),
        lambda: metrics.summarize(np.zeros((2, 2)), np.ones((2, 2))),
        lambda: metrics.flip(np.zeros((2, 3)), np.zeros((2, 3))),
    ],
)
def test_wrong_shapes_are_refused(call):
    with pytest.raises(ValueError, match=r"expected|does not fit|needs"):
        call()
