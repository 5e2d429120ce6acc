"""The skin map against the phantom's labels, against a real head, and as a user paints it."""

from __future__ import annotations

import numpy as np
import pytest
from scan_shapes import SCANS, sphere, write_obj
from scipy.special import erf

from scanrender import images
from scanrender.asset import Mesh
from scanrender.errors import ConfigError, ScanError
from scanrender.phantom import LABELS, make_head
from scanrender.phantom import albedo as phantom_albedo
from scanrender.phantom.masks import masks_at
from scanrender.phantom.shape import make_shape, template_from_truth
from scanrender.phantom.unwrap import unwrap as atlas_of
from scanrender.scan.bake_shape import ambient_occlusion
from scanrender.scan.bakedlight import baked_light
from scanrender.scan.high import Low
from scanrender.scan.ingest import read_scan
from scanrender.scan.prepare import prepare
from scanrender.scan.rasterize import rasterize
from scanrender.scan.rays import Target
from scanrender.scan.skinmap import skin_probability
from scanrender.scan.skinmask import read_skin_mask
from scanrender.scan.texelgraph import TexelGraph
from scanrender.scan.topology import unit, vertex_normals
from scanrender.scan.unwrap import Unwrapped
from scanrender.settings.prep import PrepSettings
from scanrender.settings.scan import ScanSettings

MM = ScanSettings(units="mm", up="+y", front="+z")
DEMO_PX, COARSE_PX = 1184, 592  # of this atlas: about .47 mm a texel as in the demo, and twice that


def low_of(positions, faces, uv, faces_uv, source):
    """A prepared mesh without a preparation: uv (n, 2) with faces_uv (m, 3), source (n,)."""
    normals = vertex_normals(positions, faces)
    mesh = Mesh(positions[source].astype(np.float32), normals[source].astype(np.float32),
                np.zeros((len(uv), 4), np.float32), uv.astype(np.float32),
                faces_uv.astype(np.uint32))  # fmt: skip
    unwrapped = Unwrapped(source, faces_uv, uv, np.zeros(len(faces), np.int64), {})
    return Low(positions, faces.astype(np.int64), normals, unwrapped, mesh)


class Phantom:
    """The phantom as a prepared mesh, its colours asked for at the texels themselves."""

    def __init__(self):
        head = make_head(25_000)
        atlas = atlas_of(head.positions_mm, head.faces, 1, 4096)
        source = np.zeros(len(atlas.texels), np.int64)
        source[atlas.corner] = head.faces
        self.low = low_of(head.positions_mm, head.faces, atlas.texels / 4096, atlas.corner, source)
        low = self.low
        self.ao = ambient_occlusion(
            Target(low.positions, low.faces), low.positions, low.normals, 16, 80.0
        )

    def texels(self, size):
        return rasterize(self.low.mesh.uv, self.low.mesh.faces, size)

    def seen(self, size, seed=0):
        """Colours (k, 3) as a camera with texels of this size sees them, and labels (k,)."""
        texels = self.texels(size)
        points = texels.interpolate(self.low.positions[self.low.faces]).astype(np.float64)
        template = template_from_truth(points, make_shape(0))
        masks = masks_at(template, seed)
        return phantom_albedo.albedo_at(template, masks, self.low.texel_mm(size), seed)

    def found(self, size, colors):
        skin, notes = skin_probability(self.low, self.texels(size), colors, self.ao)
        assert skin.min() >= 0.0
        assert skin.max() <= 1.0
        return skin, notes


@pytest.fixture(scope="module")
def phantom():
    return Phantom()


@pytest.fixture(scope="module")
def fine(phantom):
    return phantom.seen(DEMO_PX)


def overlap(found, truth):
    return float((found & truth).sum() / (found | truth).sum())


def scores(skin, label):
    """Intersection over union of skin, of the rest, and of eyes and brows away from the hair."""
    name = np.array(LABELS)[label]
    found, truth = skin > 0.5, np.isin(name, ["skin", "lips"])
    face = name != "hair"
    small = np.isin(name, ["eye", "brow"])
    result = overlap(found, truth), overlap(~found, ~truth), overlap(~found[face], small[face])
    print("IoU skin {:.3f}, non-skin {:.3f}, eyes and brows {:.3f}".format(*result))
    return result


def test_skin_at_the_demos_resolution(phantom, fine):
    colors, label = fine
    assert 0.42 < phantom.low.texel_mm(DEMO_PX) < 0.52
    skin, other, small = scores(phantom.found(DEMO_PX, colors)[0], label)
    assert skin >= 0.95
    assert other >= 0.9
    assert small >= 0.7


def test_skin_under_noise_and_speckles(phantom, fine):
    colors, label = fine
    rng = np.random.default_rng(1)
    encoded = images.srgb_from_linear(colors) + rng.normal(0.0, 6 / 255, colors.shape)
    speckled = rng.random(len(colors)) < 0.003
    encoded[speckled] = rng.random((int(speckled.sum()), 3))
    seen = images.linear_from_srgb(encoded).astype(np.float32)
    skin, other, small = scores(phantom.found(DEMO_PX, seen)[0], label)
    assert skin >= 0.95
    assert other >= 0.9
    assert small >= 0.7


def test_skin_under_the_light_of_the_capture(phantom, fine):
    """A key light from the side, four times as bright as what is left in its shade."""
    colors, label = fine
    low, texels = phantom.low, phantom.texels(DEMO_PX)
    normal = unit(texels.interpolate(low.normals[low.faces]), fallback=(0.0, 0.0, 1.0))
    lit = 0.25 + 0.75 * np.clip(normal @ unit(np.array([0.8, 0.2, 0.6])), 0.0, 1.0)
    seen = (colors * lit[:, None]).astype(np.float32)
    found, _ = phantom.found(DEMO_PX, seen)
    skin, other, small = scores(found, label)
    assert skin >= 0.95
    assert other >= 0.9
    assert small >= 0.7
    light, without = baked_light(seen, normal, found), baked_light(colors, normal, found)
    assert light["explained"] > 0.5
    assert light["contrast"] > 0.15
    assert without["explained"] < 0.08
    assert light["direction"][0] > 0.5


TONES = {
    "pale": ((0.76, 0.53, 0.46), (0.58, 0.27, 0.26), None),
    "tan": ((0.42, 0.206, 0.138), (0.36, 0.123, 0.10), None),
    "brown": ((0.252, 0.094, 0.048), (0.244, 0.068, 0.046), None),
    "black": ((0.13, 0.07, 0.045), (0.14, 0.06, 0.05), (0.02, 0.017, 0.015)),
    "blond": ((0.70, 0.45, 0.37), (0.52, 0.21, 0.21), (0.30, 0.20, 0.10)),
}


@pytest.mark.parametrize("tone", TONES)
def test_skin_of_any_tone(phantom, monkeypatch, tone):
    skin, lips, hair = TONES[tone]
    ratio = np.array(skin) / phantom_albedo._SKIN
    monkeypatch.setattr(phantom_albedo, "_SKIN", np.array(skin))
    monkeypatch.setattr(phantom_albedo, "_LIPS", np.array(lips))
    monkeypatch.setattr(phantom_albedo, "_VEIL", phantom_albedo._VEIL * ratio)
    if hair is not None:
        monkeypatch.setattr(phantom_albedo, "_HAIR", np.array(hair))
    colors, label = phantom.seen(COARSE_PX)
    found, _ = phantom.found(COARSE_PX, colors)
    skin_score, other, small = scores(found, label)
    assert skin_score >= 0.93
    assert other >= 0.9
    assert small >= 0.7
    name = np.array(LABELS)[label]
    assert (found[name == "lips"] > 0.5).mean() > 0.95


def test_exposure_does_not_matter(phantom):
    colors, _ = phantom.seen(COARSE_PX)
    bright = phantom.found(COARSE_PX, colors)[0]
    dark = phantom.found(COARSE_PX, 0.4 * colors)[0]
    assert (np.abs(bright - dark) > 0.5).mean() < 2e-3


def test_a_surface_without_skins_colour_is_all_skin(phantom):
    """Stained marble: grey, dark stains as large as brows."""
    texels = phantom.texels(COARSE_PX)
    low = phantom.low
    points = texels.interpolate(low.positions[low.faces])
    stain = np.sin(points / 9.0).prod(axis=1) > 0.4
    colors = np.where(stain[:, None], 0.12, 0.5) * np.array([1.02, 1.0, 0.95])
    found, notes = phantom.found(COARSE_PX, colors.astype(np.float32))
    assert notes == {"no_skin_colour": True}
    assert (found == 1.0).all()


def two_charts(side=64, gap=8):
    """A 64 mm square in two charts side by side, 1 mm a texel, and its graph."""
    size = side + gap
    x, y = np.meshgrid(np.linspace(0.0, side, 17), np.linspace(0.0, side, 17))
    positions = np.stack([x, -y, 0.0 * x], axis=-1).reshape(-1, 3)
    cell = (np.arange(16)[:, None] * 17 + np.arange(16)).reshape(-1)
    faces = np.concatenate(
        [np.stack([cell, cell + 17, cell + 1], 1), np.stack([cell + 1, cell + 17, cell + 18], 1)]
    )
    right = positions[faces][:, :, 0].mean(axis=1) > side / 2
    corner = positions[faces][:, :, :2] * [1.0, -1.0]
    corner[right, :, 0] += gap
    uv, faces_uv = corner.reshape(-1, 2) / size, np.arange(faces.size).reshape(-1, 3)
    texels = rasterize(uv, faces_uv, size)
    low = low_of(positions, faces, uv, faces_uv, faces.reshape(-1))
    points = texels.interpolate(low.positions[low.faces])
    up = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return points, TexelGraph(texels, points, up, 1.0)


def test_islands_and_blurs_do_not_stop_at_a_seam():
    points, graph = two_charts()
    strip = np.abs(points[:, 1] + 32.0) < 5.0
    assert graph.islands(strip)[2] == 1
    assert graph.areas_mm2(strip)[strip] == pytest.approx(640.0)
    assert graph.areas_mm2(strip)[~strip].max() == 0.0
    # A step at the seam x = 32 becomes an error function, as if there were no seam.
    soft = graph.smooth((points[:, 0] < 32.0).astype(float), 3.0)
    expected = 0.5 - 0.5 * erf((points[:, 0] - 32.0) / (3.0 * np.sqrt(2.0)))
    inner = (np.abs(points[:, 0] - 32.0) < 15.0) & (np.abs(points[:, 1] + 32.0) < 20.0)
    assert np.abs(soft - expected)[inner].max() < 0.03


def test_smoothing_along_the_surface_keeps_the_mean():
    points, graph = two_charts()
    values = np.random.default_rng(0).random((len(points), 2))
    soft = graph.smooth(values, 2.0)
    assert soft.mean(axis=0) == pytest.approx(values.mean(axis=0), abs=1e-4)
    assert soft.std() < 0.2 * values.std()


LEE = SCANS / "lee_perry_smith" / "LeePerrySmith.obj"
# Boxes (x, y, z from; to) in mm of the asset at 388 mm, and the share of skin within.
REGIONS = {
    "right brow": ((-50, 97, 85), (-26, 101, 110), (0.0, 0.2)),
    "left brow": ((20, 95, 85), (42, 99, 110), (0.0, 0.2)),
    "lips": ((-20, 17, 90), (16, 29, 130), (0.98, 1.0)),
    "right eyelid": ((-46, 79, 70), (-26, 89, 110), (0.98, 1.0)),
    "left eyelid": ((20, 79, 70), (42, 87, 110), (0.98, 1.0)),
    "cheek": ((-45, 45, 60), (-28, 65, 110), (0.98, 1.0)),
    "forehead": ((-35, 112, 60), (35, 135, 110), (0.98, 1.0)),
    "nose": ((-12, 50, 90), (12, 75, 140), (0.98, 1.0)),
    "under the chin": ((-40, -30, 60), (40, -10, 115), (0.95, 1.0)),
    "right ear": ((-95, 45, -30), (-72, 100, 20), (0.98, 1.0)),
    "left ear": ((72, 45, -30), (95, 100, 20), (0.98, 1.0)),
}


@pytest.fixture(scope="module")
def lee(tmp_path_factory):
    """Positions (k, 3) mm and skin (k,) at the texels."""
    if not LEE.exists():
        pytest.skip("Lee Perry-Smith's scan is not here")
    bake = {"albedo_px": 1024, "data_px": 1024, "normal_px": 64, "ao_rays": 16}
    bake["maps"] = ["albedo", "ao", "skin"]
    settings = PrepSettings.model_validate({"report": "short", "bake": bake})
    out = tmp_path_factory.mktemp("lee") / "asset"
    asset = prepare(LEE, ScanSettings(height_mm=388), settings, out, as_is=True)
    assert not [x for x in asset.info["warnings"] if "light" in x or "skin" in x]
    texels = rasterize(asset.mesh.uv, asset.mesh.faces, 1024)
    points = texels.interpolate(asset.mesh.positions_mm[asset.mesh.faces])
    return points, asset.maps["skin"].reshape(-1)[texels.index]


@pytest.mark.parametrize("region", REGIONS)
def test_a_real_head(lee, region):
    points, skin = lee
    low, high, (least, most) = REGIONS[region]
    inside = ((points > low) & (points < high)).all(axis=1)
    assert inside.sum() > 100
    assert least <= (skin[inside] > 0.5).mean() <= most


def bust(folder, pages=1):
    """A sphere of skin with a texture for each half of it, and prep settings for small maps."""
    positions, faces, uv = sphere(100.0, 24, 48)
    written = write_obj(folder / "bust.obj", positions, faces, uv, "bust.mtl", "page_0")
    names = [f"color_{k}.png" for k in range(pages)]
    for name in names:
        images.write_srgb_png(folder / name, np.tile(np.float32([0.6, 0.37, 0.3]), (16, 16, 1)))
    (folder / "bust.mtl").write_text(
        "".join(f"newmtl page_{k}\nmap_Kd {name}\n" for k, name in enumerate(names))
    )
    if pages == 2:
        lines = written.read_text().splitlines()
        first = next(i for i, line in enumerate(lines) if line.startswith("f "))
        lines.insert(first + len(faces) // 2, "usemtl page_1")
        written.write_text("\n".join(lines) + "\n")
    return written


def masked(scan, mask, out, **bake):
    bake = {"albedo_px": 128, "normal_px": 16, "data_px": 128, "maps": ["albedo", "skin"], **bake}
    prep = {"report": "short", "bake": bake, "skin": {"mask": mask}}
    return prepare(scan, MM, PrepSettings.model_validate(prep), out, as_is=True)


def skin_at_surface(asset):
    size = asset.maps["skin"].shape[0]
    texels = rasterize(asset.mesh.uv, asset.mesh.faces, size)
    points = texels.interpolate(asset.mesh.positions_mm[asset.mesh.faces])
    return points, asset.maps["skin"].reshape(-1)[texels.index]


def test_a_users_mask_replaces_the_guess(tmp_path):
    """Painted in the scan's own UVs: white above the equator, grey 102 in a band, black below."""
    scan = bust(tmp_path)
    painted = np.zeros((90, 60), np.uint8)
    painted[:45], painted[45:60] = 255, 102
    (tmp_path / "painted").mkdir()
    images.write_image(tmp_path / "painted" / "skin.png", painted)
    asset = masked(scan, "painted/skin.png", tmp_path / "out")
    points, skin = skin_at_surface(asset)
    latitude = np.degrees(np.arcsin(points[:, 1] / np.linalg.norm(points, axis=1)))
    # Image row r of 90 is 90 - 2 r degrees north.
    assert skin[latitude > 4.0].min() > 0.99
    assert skin[(latitude < -4.0) & (latitude > -26.0)] == pytest.approx(0.4, abs=0.02)
    assert skin[latitude < -34.0].max() < 0.01
    stage = next(x for x in asset.info["stages"] if x["name"] == "skin")
    assert stage["notes"]["from"] == "mask"
    assert asset.info["settings"]["prep"]["skin"]["mask"] == "painted/skin.png"


def test_one_mask_for_each_page(tmp_path):
    scan = bust(tmp_path, pages=2)
    for name, level in (("a.png", 255), ("b.png", 0)):
        images.write_image(tmp_path / name, np.full((8, 8), level, np.uint8))
    # write_obj's faces run around the sphere: the first half of them is at positive x.
    points, skin = skin_at_surface(masked(scan, ["a.png", "b.png"], tmp_path / "out"))
    assert skin[points[:, 0] > 5.0].min() > 0.99
    assert skin[points[:, 0] < -5.0].max() < 0.01


def test_a_mask_for_a_scan_whose_colours_lie_at_its_vertices(tmp_path):
    """Texture coordinates without a texture are enough; so is no colour at all."""
    positions, faces, uv = sphere(100.0, 24, 48)
    scan = write_obj(tmp_path / "a.obj", positions, faces, uv)
    painted = np.zeros((64, 64), np.uint8)
    painted[:32] = 255
    (tmp_path / "masks").mkdir()
    images.write_image(tmp_path / "masks" / "skin.png", painted)
    points, skin = skin_at_surface(masked(scan, "masks/skin.png", tmp_path / "out"))
    assert skin[points[:, 1] > 8.0].min() > 0.99
    assert skin[points[:, 1] < -8.0].max() < 0.01


def test_a_mask_that_does_not_suit_is_told(tmp_path):
    def read(scan, names):
        return read_skin_mask(scan, read_scan(scan), names)

    scan = bust(tmp_path)
    image = tmp_path / "skin.png"
    images.write_image(image, np.zeros((4, 4), np.uint8))
    assert len(read(scan, "skin.png").pages) == len(read(scan, ("SKIN.PNG",)).pages) == 1
    with pytest.raises(ConfigError, match=r"the skin mask lost\.png is missing") as missing:
        read(scan, "lost.png")
    assert missing.value.where.startswith("prep.skin.mask")
    with pytest.raises(ConfigError, match=r"1 texture page .*, and the skin mask 2 images") as two:
        read(scan, ("skin.png", "skin.png"))
    assert "color_0.png" in two.value.what
    assert "name 1 image" in two.value.fix
    (tmp_path / "text.png").write_text("no image")
    with pytest.raises(ScanError, match=r"the skin mask text\.png"):
        read(scan, "text.png")
    inner = tmp_path / "scan"
    inner.mkdir()
    positions, faces, uv = sphere(100.0, 8, 16)
    plain = write_obj(inner / "plain.obj", positions, faces)
    with pytest.raises(ConfigError, match=r"texture coordinates, and plain\.obj has none"):
        read(plain, "skin.png")
    mapped = write_obj(inner / "mapped.obj", positions, faces, uv)
    for outside in ("../skin.png", str(image), "https://example.org/skin.png"):
        with pytest.raises(ConfigError, match="outside the scan's folder"):
            read(mapped, outside)
    (inner / "link.png").symlink_to(image)
    with pytest.raises(ConfigError, match="a link that leaves the scan's folder"):
        read(mapped, "link.png")


def test_an_unsuitable_mask_leaves_no_asset(tmp_path):
    with pytest.raises(ConfigError, match="is missing"):
        masked(bust(tmp_path), "lost.png", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_head_in_metres_that_is_called_millimetres_has_a_skin_map(tmp_path):
    """No texel of it is as large as skin needs: a map is halved only while it still has texels."""
    positions, faces, uv = sphere(0.1, 8, 16)
    colors = np.tile([0.85, 0.62, 0.5], (len(positions), 1))
    narrow = uv * [0.4, 1.0]  # nothing in the middle, where the only texel of a map of 1 px lies
    scan = write_obj(tmp_path / "a.obj", positions, faces, narrow, colors=colors)
    bake = {"albedo_px": 128, "data_px": 128, "normal_px": 16, "maps": ["skin"]}
    prep = PrepSettings.model_validate({"report": "short", "bake": bake})
    asset = prepare(scan, MM, prep, tmp_path / "out", as_is=True)
    assert asset.maps["skin"].shape == (128, 128, 1)
    assert asset.maps["skin"].min() > 0.99
