"""What must hold of a picture at every extreme: each invariant renders a case one or two ways and
says how far it is from holding.

A refusal (an error of ours, in a sentence) is no fault; a wrong picture, or any other error, is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from scanrender.asset import Asset, Mesh
from scanrender.errors import ScanrenderError, StageError
from scanrender.measure.extreme_meshes import AMBIGUOUS, asset_of, ball, joined
from scanrender.measure.extremes import Case, Data
from scanrender.metrics import delta_e_2000_linear
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.render.lamps import light_level
from scanrender.settings.pipeline import Pipeline

Picture = npt.NDArray[np.float64]
# Pixels without an edge in them: of fewer, 5 % are no more than the border of the shadow.
FEWEST = 300


@dataclass(frozen=True)
class Finding:
    """How far an invariant is from holding: `figure` must not pass `bound`."""

    invariant: str
    figure: float
    bound: float
    sentence: str = ""

    @property
    def holds(self) -> bool:
        return bool(self.figure <= self.bound)


@dataclass(frozen=True)
class Refusal:
    """The case cannot be rendered, and says so in a sentence."""

    sentence: str


Test = Callable[[Device, Case], "Finding | None"]


def _frame(device: Device, asset: Asset, pipeline: Pipeline, *buffers: str) -> Any:
    renderer = Renderer(device, asset, pipeline)
    return renderer.render(renderer.view(1), buffers)


def _beauty(device: Device, asset: Asset, pipeline: Pipeline) -> Picture:
    """(h, w, 4) RGB and coverage, float64."""
    frame = _frame(device, asset, pipeline)
    return np.dstack([frame.buffers["beauty"], frame.alpha]).astype(np.float64)


def apart(case: Case, one: Picture, other: Picture) -> Picture:
    """dE2000 (h, w) of two pictures, both exposed for the brighter parts of the first; but nobody
    lifts what is darker than a fiftieth of a white face in all of the scene's light."""
    least = max(0.02 * light_level(case.pipeline().lights), 1e-30)
    bright = max(float(np.quantile(one[:, :, :3], 0.98)), least)
    return delta_e_2000_linear(other[:, :, :3] / bright, one[:, :, :3] / bright)


def _quantile(values: Picture, share: float) -> float:
    return float(np.quantile(values, share)) if values.size else 0.0


def sound(device: Device, case: Case) -> Finding | None:
    """No NaN, infinity, negative light or value out of range in any pass."""
    pipeline = case.pipeline({"quality": {"check": True}})
    try:
        renderer = Renderer(device, case.asset(), pipeline)
        frame = renderer.render(renderer.view(1))
    except StageError as error:
        return Finding("sound", 1.0, 0.0, f"{error.what} ({error.where})")
    display = frame.buffers["display"]
    bad = ~np.isfinite(display) | (display < 0.0) | (display > 1.0)
    return Finding("sound", float(bad.sum()), 0.0, "values of display")


def same_bits(device: Device, case: Case) -> Finding | None:
    """Two runs give the same bits."""
    one, two = (_beauty(device, case.asset(), case.pipeline()) for _ in range(2))
    return Finding("same bits", float((one != two).sum()), 0.0)


def linear(device: Device, case: Case) -> Finding | None:
    """Light times 2^20, or divided by it, is the picture times that, before the view transform.

    `sampling: contrast` looks at the exposed picture: the exposure takes the factor back, before a
    background that has no light to multiply.
    """
    lights = case.settings["lights"]
    key = {"environment": "intensity"}
    brightest = max((x.get(key.get(x["type"], "irradiance"), 1.0) for x in lights), default=0.0)
    factor = 2.0**-20 if brightest > 1.0 else 2.0**20
    scaled = []
    for light in lights:
        name = key.get(light["type"], "irradiance")
        scaled.append({**light, name: min(light.get(name, 1.0) * factor, 1e9)})
    stops = case.settings.get("view", {}).get("exposure_ev", 0.0) - np.log2(factor)
    if not lights or abs(stops) > 30 or brightest * factor > 1e9:
        return None
    full: Data = {"quality": {"precision": "full"}, "view": {"background": [0.0, 0.0, 0.0]}}
    changed = case.pipeline(full, {"lights": scaled, "view": {"exposure_ev": stops}})
    one = _beauty(device, case.asset(), case.pipeline(full))[:, :, :3] * factor
    two = _beauty(device, case.asset(), changed)[:, :, :3]
    floor = 1e-6 * max(one.max(), two.max(), 1e-37)
    off = np.abs(one - two) / np.maximum(np.maximum(one, two), floor)
    return Finding("intensity", float(off.max(initial=0.0)), 1e-3, "relative, largest")


def furnace(device: Device, case: Case) -> Finding | None:
    """Under light from everywhere that is the same everywhere, what scatters is what came in."""
    diffusion = case.settings.get("diffusion", {})
    loses = diffusion.get("method") == "disk" and diffusion.get("normalize") == "none"
    if diffusion.get("method") == "none" or loses:
        return None
    changed = case.pipeline({
        "lights": [{"type": "ambient", "irradiance": 1.0}], "skin": {"texturing": "post"},
        "quality": {"precision": "full"},
    })  # fmt: skip
    asset = case.asset()
    asset = Asset(asset.mesh, {k: v for k, v in asset.maps.items() if k != "ao"})
    renderer = Renderer(device, asset, changed)
    if "scattered" not in renderer.buffer_names:
        return None
    made = renderer.render(renderer.view(1), ["scattered", "irradiance", "depth_mm"]).buffers
    seen = made["depth_mm"][:, :, 0] > 0.0
    # Of what reflects all there is (f0: 1), none scatters.
    light, came = made["scattered"][seen], made["irradiance"][seen]
    off = np.abs(light - came) / np.where(came > 0.0, came, 1.0)
    return Finding("furnace", float(off.max(initial=0.0)), 1e-3, "relative, largest")


def _of_few_or_many(test: Callable[[int], Finding | None]) -> Finding | None:
    """`test` of 4 x 4 samples, or where they are too few of 8 x 8: what differs because samples,
    and the taps of a shadow, fall elsewhere is a quarter to a half then, and a fault is not."""
    few = test(4)
    return few if few is None or few.holds else test(8)


def mirrored(device: Device, case: Case) -> Finding | None:
    """A mirrored scene gives the mirrored picture; of 16 or 64 samples, whose places are not."""
    return _of_few_or_many(lambda side: mirrored_of(device, case, side))


def mirrored_of(device: Device, case: Case, side: int) -> Finding | None:
    """`mirrored` of side x side samples."""
    # Taps of shadows follow the normals, and where these are none of the surface's, they are noise.
    if any(light["type"] == "environment" for light in case.settings["lights"]):
        return None
    noisy = case.shape in (*AMBIGUOUS, "random_normals", "no_normals")
    if noisy or case.settings["diffusion"].get("jitter"):
        return None
    lights = [_mirrored_light(light) for light in case.settings["lights"]]
    camera = {"azimuth_deg": -case.settings["camera"].get("azimuth_deg", 0.0)}
    turn = {"degrees": -case.pipeline().turntable.degrees}
    sampled = _sampled(side)
    changed = case.pipeline({"lights": lights, "camera": camera, "turntable": turn}, sampled)
    asset = case.asset()
    one = _beauty(device, asset, case.pipeline(sampled))
    two = _beauty(device, Asset(_mirrored_mesh(asset.mesh), asset.maps), changed)[:, ::-1]
    whole = np.minimum(one[:, :, 3], two[:, :, 3]) > 1.0 - 1e-5
    if whole.sum() < FEWEST:
        return None
    return Finding("mirror", _quantile(apart(case, one, two)[whole], 0.95), 0.5, "dE2000, 95 %")


def _mirrored_light(light: Data) -> Data:
    changed: Data = {}
    if light["type"] != "ambient":
        changed["azimuth_deg"] = -light.get("azimuth_deg", 30.0)
    if light.get("position_mm"):
        x, y, z = light["position_mm"]
        changed["position_mm"] = [-x, y, z]
    return {**light, **changed}


def _mirrored_mesh(mesh: Mesh) -> Mesh:
    flip = np.array([-1.0, 1.0, 1.0], np.float32)
    tangents = mesh.tangents * np.array([-1.0, 1.0, 1.0, -1.0], np.float32)
    return Mesh(mesh.positions_mm * flip, mesh.normals * flip, tangents, mesh.uv,
                np.ascontiguousarray(mesh.faces[:, ::-1]))  # fmt: skip


def order(device: Device, case: Case) -> Finding | None:
    """The order of triangles and of lights changes nothing, coincident surfaces excepted."""
    if case.shape in AMBIGUOUS:
        return None
    asset = case.asset()
    shuffled = np.random.default_rng(5).permutation(len(asset.mesh.faces))
    mesh = replace(asset.mesh, faces=asset.mesh.faces[shuffled])
    lights = case.settings["lights"][::-1]
    one = _beauty(device, asset, case.pipeline())
    two = _beauty(device, Asset(mesh, asset.maps), case.pipeline({"lights": lights}))
    return Finding("order", float(apart(case, one, two).max(initial=0.0)), 0.1, "dE2000, largest")


def unseen(device: Device, case: Case) -> Finding | None:
    """Something inside a closed subject, that no light and no camera sees, changes nothing."""
    lamps = [x for x in case.settings["lights"] if x.get("position_mm")]
    baked = case.settings.get("skin", {}).get("transmission", {}).get("method") == "baked"
    if case.shape not in ("ball", "zero_area") or lamps or baked:
        return None
    asset = case.asset()
    if Renderer(device, asset, case.pipeline()).camera.distance_mm < 0.6 * case.size_mm:
        return None  # the camera may stand inside
    inner = ball(60, 0.02 * case.size_mm)
    one = _beauty(device, asset, case.pipeline())
    two = _beauty(device, Asset(joined(asset.mesh, inner), asset.maps), case.pipeline())
    return Finding(
        "unseen object", float(apart(case, one, two).max(initial=0.0)), 0.1, "dE2000, largest"
    )


def turned(device: Device, case: Case) -> Finding | None:
    """The world turned about its axis, camera and lights with it: the same picture."""
    angle = 73.0
    lights = []
    for light in case.settings["lights"]:
        changed = dict(light)
        if light["type"] != "ambient":
            changed["azimuth_deg"] = light.get("azimuth_deg", 30.0) + angle
        if light.get("position_mm"):
            changed["position_mm"] = (_about_y(angle) @ light["position_mm"]).tolist()
        lights.append(changed)
    azimuth = case.settings["camera"].get("azimuth_deg", 0.0) + angle
    # Frame 1 of 4 shows the subject turned by -90 degrees; it turns on by `angle` against that.
    turn = {"start_deg": -angle}
    asset = case.asset()
    one = _beauty(device, asset, case.pipeline())
    changed_case = case.pipeline(
        {"lights": lights, "camera": {"azimuth_deg": azimuth}, "turntable": turn}
    )
    two = _beauty(device, asset, changed_case)
    return Finding("rotation", _quantile(apart(case, one, two), 0.95), 0.5, "dE2000, 95 %")


def _about_y(degrees: float) -> Picture:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


LENGTHS = (
    ("skin", "scale"), ("diffusion", "limit_smooth_mm"), ("curvature", "smooth_mm"),
    ("curvature", "full_at_mm"), ("camera", "height_mm"), ("camera", "look_up_mm"),
)  # fmt: skip
SCALE = 4.0


def scaled(device: Device, case: Case) -> Finding | None:
    """Everything four times as large, skin and light with it: the same picture."""
    base = case.pipeline()
    # The guide of cbf grows with the distance in metres by its definition; no curvature of a face
    # is beyond a limit, which has a unit.
    if base.diffusion.halo == "cbf" or base.curvature.modulation != "none":
        return None
    data = base.model_dump(mode="json")
    for section, name in LENGTHS:
        data[section][name] *= SCALE
    for name in ("bias_mm", "blur_mm"):
        data["skin"]["transmission"][name] *= SCALE
    for light in data["lights"]:
        for name in ("distance_mm", "radius_mm", "shadow_blur_mm"):
            if name in light:
                light[name] *= SCALE
        if light.get("position_mm"):
            light["position_mm"] = [SCALE * x for x in light["position_mm"]]
    try:
        changed = Pipeline.model_validate(data)
    except ValidationError:
        return None  # four times as large is more than some setting allows
    one = case.asset()
    large = asset_of(case.shape, case.size_mm * SCALE, case.maps)
    lengths = {"thickness_mm": SCALE, "curvature": 1.0 / SCALE}
    maps = {name: pixels * lengths.get(name, 1.0) for name, pixels in large.maps.items()}
    two = _beauty(device, Asset(large.mesh, maps), changed)
    off = apart(case, _beauty(device, one, base), two)
    return Finding("scale", float(off.max(initial=0.0)), 0.5, "dE2000, largest")


def finer(device: Device, case: Case) -> Finding | None:
    """Twice the resolution, box-filtered, agrees with the picture; sampled alike, everywhere."""
    return _of_few_or_many(lambda side: finer_of(device, case, side))


def finer_of(device: Device, case: Case, side: int) -> Finding | None:
    """`finer` of side x side samples, and of the same number in four pixels."""
    camera = case.pipeline().camera
    small, large = sorted((camera.width_px, camera.height_px))
    # Half the resolution for diffusion is a trade for speed, and finer where the picture is.
    halved = case.pipeline().diffusion.resolution == "half"
    if case.shape in AMBIGUOUS or small < 24 or large > 64 or halved or _bends_by_pixel(case):
        return None
    size = {"width_px": 2 * camera.width_px, "height_px": 2 * camera.height_px}
    one = _beauty(device, case.asset(), case.pipeline(_sampled(side)))
    changed = case.pipeline({"camera": size}, _sampled(side // 2))
    big = _beauty(device, case.asset(), changed)
    if one[:, :, 3].max() < 1.0 - 1e-5:
        return None  # nothing that is as wide as a pixel
    box = big.reshape(camera.height_px, 2, camera.width_px, 2, 4).mean(axis=(1, 3))
    return Finding("resolution", float(apart(case, one, box).mean()), 0.7, "dE2000, mean")


def _bends_by_pixel(case: Case) -> bool:
    """Whether scattering follows the curvature, on the screen, of normals that are noise: they turn
    within a pixel or two, and what their differences are depends on where the pixels lie."""
    curvature = case.pipeline().curvature
    follows = curvature.modulation != "none" and curvature.source == "screen"
    return follows and case.shape == "random_normals"


def _sampled(side: int) -> Data:
    return {"quality": {"supersampling": side, "sampling": "everywhere"}}


INVARIANTS: Mapping[str, Test] = {
    "sound": sound,
    "same bits": same_bits,
    "intensity": linear,
    "furnace": furnace,
    "mirror": mirrored,
    "order": order,
    "unseen object": unseen,
    "rotation": turned,
    "scale": scaled,
    "resolution": finer,
}


def examine(device: Device, case: Case, name: str) -> Finding | Refusal | None:
    """Test one invariant of a case; None where it does not apply."""
    try:
        return INVARIANTS[name](device, case)
    except ScanrenderError as error:
        return Refusal(str(error).splitlines()[0])
    except Exception as error:  # noqa: BLE001  any other error is what is looked for
        return Finding(name, float("inf"), 0.0, f"{type(error).__name__}: {error}")
