"""What every diffusion filter shares: the uniforms, switches and inputs of `scatter.glsl`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot

# Size of the shaders' arrays; `diffusion.samples` is bounded by it.
MAX_TAPS = 255
DIRECTIONS = ((1, 0), (0, 1))
EDGE_GUIDED = ("cbf", "cbf_normalized")


@dataclass(frozen=True)
class WeightDraw:
    """One step of a filter: its direction, its taps' uniforms, and its share in the whole."""

    direction: tuple[int, int]
    taps: Mapping[str, Any]
    share: tuple[float, float, float]
    rejected_share: float


def switches(scene: Scene) -> tuple[str, ...]:
    """The `#define`s of this scene's diffusion."""
    diffusion = scene.pipeline.diffusion
    # The disk measures distance and area itself, and needs what `measure` needs for it.
    disk = diffusion.method == "disk"
    # The paper uses its normalized guide along with the depth correction, and Mikkelsen's alone.
    on = {
        "HALO_DEPTH": diffusion.halo in ("depth", "cbf_normalized"),
        "HALO_MEASURE": disk or diffusion.halo == "measure",
        "GUIDE_EDGE": diffusion.halo in EDGE_GUIDED,
        "GUIDE_LAB": diffusion.limit == "lab",
        "CURVATURE": scene.pipeline.curvature.modulation != "none",
        "JITTER": diffusion.jitter,
        "MISSING_MASS": disk and diffusion.normalize == "none",
    }
    return tuple(name for name, used in on.items() if used)


def defines(scene: Scene, shot: Shot) -> tuple[str, ...]:
    """`switches`, and FOLD where the guard band was capped: taps reach past what is rendered."""
    reach_mm = float(scene.reach_mm.max()) * largest_width_factor(scene)
    reach_px = reach_mm * shot.px_per_mm(shot.near_mm)
    return (*switches(scene), *(("FOLD",) if reach_px > shot.guard_px + 1 else ()))


def guides(scene: Scene) -> tuple[str, ...]:
    """The buffers that a filter reads beside its source."""
    on = switches(scene)
    by_switch = {
        "HALO_DEPTH": "normal_geometry",
        "HALO_MEASURE": "normal_geometry",
        "GUIDE_EDGE": "edge_guide",
        "GUIDE_LAB": "lab",
        "CURVATURE": "curvature",
    }
    return ("depth_mm", *(name for switch, name in by_switch.items() if switch in on))


def uniforms(
    scene: Scene,
    shot: Shot,
    inputs: Mapping[str, moderngl.Texture],
    source: str,
    direction: tuple[int, int],
) -> dict[str, Any]:
    """Everything of `scatter.glsl` but the outputs' shares."""
    diffusion = scene.pipeline.diffusion
    return {
        **{name: inputs[name] for name in guides(scene)},
        "source": inputs[source],
        "direction": direction,
        **shot.screen_uniforms,
        "ray": _ray(shot),
        "edge_contrast": diffusion.edge_contrast,
        "lab_falloff": 0.5 / diffusion.limit_delta_e**2,
        "lab_floor": diffusion.limit_floor,
        "width_by_curvature": width_by_curvature(scene),
        "sample_index": shot.sample,
    }


def weight_pass(scene: Scene, draws: Callable[[Shot], Iterable[WeightDraw]], name: str) -> Pass:
    """weight_sum and rejected of a filter, by its own shader: nothing that light runs through pays.

    `draws(shot)` are the filter's steps: uniforms of each, and its (RGB, scalar) share in the sum.
    """

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        device = scene.device
        program = device.program(name, defines=(*defines(scene, shot), "WEIGHTS"))
        device.context.enable(moderngl.BLEND)
        device.context.blend_func = moderngl.ONE, moderngl.ONE
        for step in draws(shot):
            common = uniforms(scene, shot, inputs, "diffusion_input", step.direction)
            shares = {"share": step.share, "rejected_share": step.rejected_share}
            bind(program, {**common, **step.taps, **shares})
            device.fill(program)

    reads = ("diffusion_input", *guides(scene))
    writes = (Buffer("weight_sum"), Buffer("rejected", components=1))
    return Pass("weight_sum", reads, writes, draw)


def width_by_curvature(scene: Scene) -> tuple[float, float, float, float]:
    """(x, y, z, 0): the kernel is x + y min(z max(curvature, 0), 1) as wide as the profile says."""
    curvature = scene.pipeline.curvature
    flat, rise = {
        "none": (1.0, 0.0),
        "increase": (1.0, 1.0),
        "reduce": (0.0, 1.0),
        "reduce_to_minimum": (curvature.minimum, 1.0 - curvature.minimum),
    }[curvature.modulation]
    return flat, rise, curvature.full_at_mm, 0.0


def largest_width_factor(scene: Scene) -> float:
    """How wide curvature can make the kernel: 2 for `increase`, otherwise 1."""
    flat, rise, _, _ = width_by_curvature(scene)
    return flat + rise


def sample_shift_px(shot: Shot, direction: tuple[int, int]) -> float:
    """The sample's place in its pixel along `direction`, in GL's axes (rows run up)."""
    right, down = shot.jitter_px
    return right if direction == (1, 0) else -down


def _ray(shot: Shot) -> tuple[float, float, float, float]:
    """View xy / depth (xy itself if orthographic) = pixel * (x, y) + (z, w), the inverse of the
    projection."""
    clip = shot.clip_from_view
    scale = 2.0 / (np.array(shot.size) * clip[[0, 1], [0, 1]])
    shift = -clip[:2, 3] if shot.is_orthographic else clip[:2, 2]
    offset = (shift - 1.0) / clip[[0, 1], [0, 1]]
    return float(scale[0]), float(scale[1]), float(offset[0]), float(offset[1])
