"""The graph runs what was asked for and nothing else, and refuses what makes no sense."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from render.synthetic import AMBIENT, MATT, pipeline, plane, sphere

from scanrender.buffers import CATALOGUE, buffer_spec
from scanrender.errors import UsageError
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.render.graph import Buffer, Graph, Pass
from scanrender.render.passes import all_passes

KEY = {"type": "directional", "azimuth_deg": 40, "elevation_deg": 30, "shadow_px": 64}
SPOT = {"type": "spot", "azimuth_deg": -150, "shadow_px": 64}
SMALL = {
    "camera": {"width_px": 40, "height_px": 32},
    "quality": {"supersampling": 1},
    "lights": [KEY, SPOT, AMBIENT],
}


def nothing(*_: Any) -> None:
    raise AssertionError("order() draws nothing")


def step(name: str, reads: tuple[str, ...], writes: tuple[str, ...]) -> Pass:
    return Pass(name, reads, tuple(Buffer(w) for w in writes), nothing)


CHAIN = [
    step("a", (), ("position", "albedo")),
    step("b", ("position",), ("irradiance",)),
    step("c", ("irradiance", "albedo"), ("diffuse",)),
    step("d", ("position",), ("specular",)),
    step("e", ("diffuse", "specular"), ("radiance",)),
]


def names(order: list[Pass]) -> list[str]:
    return [found.name for found in order]


def test_only_what_is_wanted_runs_each_once_and_after_what_it_reads():
    graph = Graph(reversed(CHAIN))
    assert names(graph.order({"irradiance"})) == ["a", "b"]
    assert names(graph.order({"albedo"})) == ["a"]
    order = names(graph.order({"radiance"}))
    assert sorted(order) == ["a", "b", "c", "d", "e"]
    for name, reads in [("b", "a"), ("c", "b"), ("d", "a"), ("e", "c"), ("e", "d")]:
        assert order.index(name) > order.index(reads)


def test_what_is_given_is_not_made():
    graph = Graph(CHAIN)
    assert names(graph.order({"diffuse"}, {"irradiance"})) == ["a", "c"]
    assert names(graph.order({"diffuse"}, {"irradiance", "albedo"})) == ["c"]


def test_the_order_does_not_depend_on_the_order_of_asking():
    graph = Graph(CHAIN)
    wanted = ["radiance", "albedo", "specular"]
    assert names(graph.order(wanted)) == names(graph.order(wanted[::-1]))


def test_two_writers_of_one_buffer_are_refused():
    with pytest.raises(ValueError, match=r"albedo is written by a and by z"):
        Graph([*CHAIN, step("z", (), ("albedo",))])


def test_a_circle_is_refused():
    graph = Graph([step("a", ("diffuse",), ("albedo",)), step("b", ("albedo",), ("diffuse",))])
    with pytest.raises(ValueError, match="circle"):
        graph.order({"diffuse"})


def test_a_buffer_that_nobody_writes_is_refused():
    with pytest.raises(ValueError, match="transmission"):
        Graph(CHAIN).order({"transmission"})


def test_a_buffer_must_be_in_the_catalogue_unless_it_is_private():
    with pytest.raises(UsageError, match="colour_of_joy"):
        Buffer("colour_of_joy")
    assert Buffer("_colour_of_joy").name not in Graph(CHAIN).names


@pytest.fixture(scope="module")
def renderer(gl: Device) -> Renderer:
    return Renderer(gl, sphere(30.0, rings=12), pipeline(SMALL))


@pytest.mark.gl
def test_irradiance_needs_no_diffusion(renderer: Renderer):
    order = names(renderer.graph.order({"irradiance"}))
    assert "gbuffer" in order
    assert not [n for n in order if "gaussian" in n or n in ("diffuse", "specular", "compose")]


@pytest.mark.gl
def test_diffuse_needs_no_specular(renderer: Renderer):
    order = names(renderer.graph.order({"diffuse"}))
    assert not {"specular", "transmission", "compose", "curvature"} & set(order)


@pytest.mark.gl
def test_a_matt_scene_without_lamps_culls_shadows_and_highlights(gl: Device):
    plain = Renderer(gl, plane(), pipeline(MATT))
    order = names(plain.graph.order({"radiance"}))
    assert not [n for n in order if n.startswith(("shadow", "visib", "specular", "transm"))]


@pytest.mark.gl
def test_no_diffusion_runs_no_filter(gl: Device):
    plain = Renderer(gl, plane(), pipeline(MATT, diffusion={"method": "none"}))
    assert not [n for n in names(plain.graph.order({"radiance"})) if "gaussian" in n]
    assert plain.guard_px == 0


@pytest.mark.gl
def test_black_lights_and_a_profile_of_no_width_are_not_run(gl: Device):
    settings = pipeline(MATT, lights=[AMBIENT, {**KEY, "irradiance": 0}], skin={"scale": 0})
    plain = Renderer(gl, plane(), settings)
    assert {d.what for d in plain.decisions} == {"lights.1", "diffusion"}
    assert plain.scene.lamps == []


@pytest.mark.gl
def test_every_buffer_of_the_catalogue_is_made_by_a_full_scene(renderer: Renderer):
    made = {buffer_spec(n).meaning for n in renderer.buffer_names}
    assert made == {spec.meaning for spec in CATALOGUE.values()}
    assert {"shadow_1", "visibility_1", "gaussian_5"} <= set(renderer.buffer_names)


@pytest.mark.gl
def test_every_buffer_can_be_dumped_with_its_channels(renderer: Renderer):
    frame = renderer.render(renderer.view(0), renderer.buffer_names)
    assert set(frame.buffers) == set(renderer.buffer_names)
    for name, pixels in frame.buffers.items():
        assert pixels.shape[2] == len(buffer_spec(name).channels), name
        size = (64, 64) if name.startswith("shadow_") else (32, 40)
        assert pixels.shape[:2] == size, name
        assert pixels.dtype == np.float32
        assert np.isfinite(pixels).all(), name


@pytest.mark.gl
def test_the_picture_is_the_same_whatever_is_asked_beside_it(renderer: Renderer):
    view = renderer.view(1)
    alone = renderer.render(view)
    beside = renderer.render(view, renderer.buffer_names)
    again = renderer.render(view, ["gaussian_3", "shadow_1"])
    for name in ("beauty", "display"):
        np.testing.assert_array_equal(alone.buffers[name], beside.buffers[name])
        np.testing.assert_array_equal(alone.buffers[name], again.buffers[name])


@pytest.mark.gl
def test_a_buffer_is_the_same_whatever_is_asked_beside_it(renderer: Renderer):
    view = renderer.view(2)
    everything = renderer.render(view, renderer.buffer_names).buffers
    for name in renderer.buffer_names:
        alone = renderer.render(view, [name]).buffers[name]
        np.testing.assert_array_equal(alone, everything[name], err_msg=name)


@pytest.mark.gl
def test_a_buffer_of_another_scene_is_a_usage_error(renderer: Renderer):
    with pytest.raises(UsageError, match="gaussian_9"):
        renderer.render(renderer.view(0), ["gaussian_9"])
    with pytest.raises(UsageError, match="nosuch"):
        renderer.render(renderer.view(0), ["nosuch"])


@pytest.mark.gl
def test_a_turntable_makes_no_new_gl_objects(renderer: Renderer, gl: Device):
    def next_names() -> npt.NDArray[np.int64]:
        """GL's next names: they grow with each object that is ever made."""
        texture = gl.context.texture((1, 1), 4, dtype="f4")
        return np.array(
            [texture.glo, gl.context.framebuffer(texture).glo, gl.context.buffer(reserve=4).glo]
        )

    def frames(count: int) -> None:
        for index in range(count):
            renderer.render(renderer.view(index), ["albedo", "gaussian_2"])

    frames(3)
    first, second = next_names(), next_names()
    frames(20)
    np.testing.assert_array_equal(next_names() - second, second - first)


@pytest.mark.gl
def test_two_runs_and_two_renderers_are_bit_identical(gl: Device):
    asset, settings = sphere(30.0, rings=12), pipeline(SMALL, quality={"supersampling": 2})
    first, second = (Renderer(gl, asset, settings) for _ in range(2))
    a = first.render(first.view(1)).buffers
    b = first.render(first.view(1)).buffers
    second.render(second.view(0))  # a frame between must leave no trace
    c = second.render(second.view(1)).buffers
    for name in ("beauty", "display"):
        np.testing.assert_array_equal(a[name], b[name])
        np.testing.assert_array_equal(a[name], c[name])


@pytest.mark.gl
def test_timings_name_the_passes(renderer: Renderer):
    timings: dict[str, float] = {}
    renderer.render(renderer.view(0), (), timings)
    assert {"gbuffer", "irradiance", "gaussian_0", "compose", "tonemap"} <= set(timings)
    assert "curvature" not in timings
    assert all(seconds > 0 for seconds in timings.values())


@pytest.mark.gl
def test_a_shadow_map_as_large_as_the_picture_is_not_cropped(gl: Device):
    settings = pipeline(SMALL, camera={"width_px": 48, "height_px": 48})
    guard = Renderer(gl, sphere(30.0, rings=12), settings).guard_px
    assert guard > 0
    side = 48 + 2 * guard
    settings = pipeline(settings.model_dump(mode="json"), lights=[{**KEY, "shadow_px": side}])
    renderer = Renderer(gl, sphere(30.0, rings=12), settings)
    shadow = renderer.render(renderer.view(0), ["shadow_0"]).buffers["shadow_0"]
    assert shadow.shape == (side, side, 1)


def test_what_nobody_reads_is_not_written(gl: Device):
    """The last of a pass's buffers: the others keep their places in its shader."""
    drawn: dict[str, int] = {}

    def counting(step: Pass) -> Pass:
        def draw(shot: Any, inputs: Any, target: Any) -> None:
            drawn[step.name] = len(target.color_attachments)
            step.draw(shot, inputs, target)

        return replace(step, draw=draw)

    renderer = Renderer(gl, sphere(20.0), pipeline(SMALL, lights=[KEY]))
    graph = Graph(map(counting, all_passes(renderer.scene)))
    shot = renderer._shot(renderer.view(0))
    graph.run(gl, renderer.pool, shot, {"radiance"})
    assert drawn["transmission"] == 1, "neither thickness nor transmittance"
    assert drawn["gbuffer"] == 6, "no ambient occlusion under a lamp alone"
    graph.run(gl, renderer.pool, shot, {"radiance", "transmittance", "ao"})
    assert (drawn["transmission"], drawn["gbuffer"]) == (3, 7)


@pytest.mark.parametrize("guard_px", [0, 2, 40])
def test_the_picture_s_part_of_the_pixels_leaves_out_the_guard_band(gl: Device, guard_px: int):
    renderer = Renderer(gl, sphere(20.0), pipeline(SMALL, lights=[KEY]))
    renderer.guard_px = guard_px
    shot = replace(renderer._shot(renderer.view(0)), scissor=(5, 0, 60, 70))
    left, low, wide, high = shot.picture_scissor
    width, height = shot.size
    edge = max(guard_px - 4, 0)
    assert (left, low) == (max(5, edge), edge)
    assert (left + wide, low + high) == (min(65, width - edge), min(70, height - edge))
    outside = replace(shot, scissor=(0, 0, 1, 1)).picture_scissor
    assert min(outside[2:]) >= 0
