"""What the commands print and write, each in a process of its own."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from render.synthetic import sphere, sphere_mesh

from scanrender import __version__
from scanrender.asset import load_asset, save_asset
from scanrender.cli.main import COMMANDS
from scanrender.errors import ScanrenderError
from scanrender.outputs.exr import read_exr
from scanrender.settings.loading import load_pipeline

HEAVY = ("numpy", "moderngl", "pydantic", "ruamel", "OpenImageIO", "trimesh", "rich", "scipy",
         "av", "PIL")  # fmt: skip
SHOW_MODULES = "import atexit, sys; atexit.register(lambda: print(*sys.modules, file=sys.stderr))"
TINY = [
    word
    for setting in (
        "camera.width_px=32", "camera.height_px=32", "turntable.frames=3",
        "quality.supersampling=1", "prep.bake.albedo_px=32", "prep.bake.normal_px=32",
        "prep.bake.data_px=16", "prep.bake.ao_rays=4", "prep.bake.thickness_rays=1",
        "prep.simplify.triangles=150", "scan.units=mm", "outputs.buffers=[]",
        "lights=[{type: directional, shadow_px: 64}]",
    )
    for word in ("--set", setting)
]  # fmt: skip


def files_in(folder: Path) -> set[str]:
    """Results; the record and the log beside them are another matter."""
    names = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    return {name for name in names if name.split("/")[-1] not in ("record.json", "log.txt")}


def write_ball(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    ball = sphere_mesh(100.0, 8)
    lines = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in ball.positions_mm]
    lines += [f"f {a} {b} {c}" for a, b, c in ball.faces + 1]
    path.write_text("\n".join(lines) + "\n")
    return path


# --- help ----------------------------------------------------------------------------------------


# The help of every command in one process, before the group's own.
ALL_HELP = f"""
{SHOW_MODULES}
from scanrender.cli.main import COMMANDS, cli
for name in COMMANDS:
    cli.main([name, "--help"], standalone_mode=False)
"""


@pytest.mark.parametrize("code", [SHOW_MODULES, ALL_HELP], ids=["group", "commands"])
def test_help_answers_without_loading_anything_heavy(cli, code: str):
    done = cli("--help", code=code)
    assert done.returncode == 0
    assert done.stdout.count("Usage: ") == (1 if code == SHOW_MODULES else 1 + len(COMMANDS))
    loaded = {name.split(".")[0] for name in done.stderr.split()}
    assert "click" in loaded, "otherwise the list of modules was not shown"
    assert loaded & set(HEAVY) == set()


def test_help_lists_every_command_and_exit_code(cli):
    text = cli("--help").stdout
    for name, (_, sentence) in COMMANDS.items():
        assert re.search(rf"^\s+{name}\s+{re.escape(sentence[:30])}", text, re.M)
    for code in {error.exit_code for error in ScanrenderError.__subclasses__()} | {0, 1, 130}:
        assert re.search(rf"\b{code}\s+\w", text), f"exit code {code}"


def test_version(cli):
    assert __version__ in cli("--version").stdout


# --- validate and schema -------------------------------------------------------------------------


def test_validate_says_ok_for_each(cli):
    done = cli("validate", "turntable", "demo")
    assert done.stdout.splitlines() == ["turntable: ok", "demo: ok"]
    assert done.stderr == ""


def test_validate_resolved_can_be_run_again(cli, tmp_path: Path):
    done = cli("validate", "turntable", "--resolved", "--set", "camera.fill=0.5")
    (tmp_path / "p.yaml").write_text(done.stdout)
    assert load_pipeline(tmp_path / "p.yaml") == load_pipeline("turntable", ["camera.fill=0.5"])


def test_schema_is_json(cli):
    assert "CameraSettings" in json.loads(cli("schema").stdout)["$defs"]


def test_dry_run_writes_nothing(cli, tmp_path: Path):
    write_ball(tmp_path / "ball.obj")
    done = cli("run", "turntable", "ball.obj", "--dry-run", "--frames", "3-5", "--out", "out")
    assert done.returncode == 0
    assert "prep + render" in done.stdout
    assert "3 frames" in done.stdout
    assert files_in(tmp_path) == {"ball.obj"}


# --- render --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def asset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cli") / "asset"
    return save_asset(sphere(20.0, (0.6, 0.3, 0.2), rings=10), folder)


@pytest.mark.gl
def test_render_lists_the_buffers_of_the_scene(cli, asset: Path):
    names = [line.split()[0] for line in cli("render", asset, "--buffers", "list").stdout.
             splitlines()]  # fmt: skip
    assert {"position", "shadow_0", "gaussian_5", "beauty", "display"} <= set(names)
    rows = json.loads(cli("render", asset, "--buffers", "list", "--json").stdout)
    assert [row["name"] for row in rows] == names
    assert all(row["meaning"] and row["unit"] for row in rows)


@pytest.mark.gl
def test_render_dumps_the_buffers_it_was_asked_for(cli, asset: Path, tmp_path: Path):
    done = cli("render", asset, *TINY, "--buffers", "albedo,depth_mm", "--frames", "1-2", "--out",
               "out", "--json")  # fmt: skip
    assert done.returncode == 0, done.stderr
    names = files_in(tmp_path / "out")
    assert names == {
        "manifest.json", "pipeline.yaml",
        *(f"frames/frame_000{i}.png" for i in (1, 2)),
        *(f"buffers/frame_000{i}.exr" for i in (1, 2)),
        *(f"buffers/frame_000{i}/{name}.png" for i in (1, 2) for name in ("albedo", "depth_mm")),
    }  # fmt: skip
    (result,) = json.loads(done.stdout)
    assert set(result["files"]) == names
    layers = read_exr(tmp_path / "out" / "buffers" / "frame_0001.exr")
    assert set(layers) == {"beauty", "alpha", "albedo", "depth_mm"}
    covered = layers["alpha"][:, :, 0] == 1
    np.testing.assert_allclose(layers["albedo"][covered].mean(axis=0), [0.6, 0.3, 0.2], atol=0.01)


@pytest.mark.gl
def test_render_dumps_all_buffers(cli, asset: Path, tmp_path: Path):
    done = cli("render", asset, *TINY, "--buffers", "all", "--out", "out")
    assert done.returncode == 0, done.stderr
    layers = read_exr(tmp_path / "out" / "buffers" / "frame_0000.exr")
    assert {"position", "gaussian_5", "curvature", "specular", "nan_map"} <= set(layers)
    assert (tmp_path / "out" / "buffers" / "frame_0000.shadow_0.exr").is_file()
    assert "buffers/ (" in done.stdout


@pytest.mark.gl
def test_openjd_progress_is_on_stdout_in_its_own_words(cli, asset: Path):
    done = cli("render", asset, *TINY, "--frames", "0-1", "--progress", "openjd", "--out", "out")
    assert "openjd_progress: 100.0" in done.stdout
    assert "openjd_status: render" in done.stdout


@pytest.mark.gl
def test_json_progress_is_one_document_a_line(cli, asset: Path):
    done = cli("render", asset, *TINY, "--frames", "all", "--progress", "json", "--out", "out",
               "--json")  # fmt: skip
    lines = [json.loads(line) for line in done.stderr.splitlines()]
    assert lines[-1] == {"stage": "render", "fraction": 1.0}
    assert json.loads(done.stdout)[0]["files"][0] == "turntable.mp4"


# --- a raw scan through everything ---------------------------------------------------------------


@pytest.mark.gl
def test_one_bad_scan_among_several(cli, tmp_path: Path):
    """Two good ones of the same name and an empty one: 8, and the good ones are complete."""
    good = [write_ball(tmp_path / who / "model.obj") for who in ("anna", "bert")]
    (tmp_path / "bad.obj").write_text("v 0 0 0\n")
    done = cli("run", "turntable", good[0], tmp_path / "bad.obj", good[1], *TINY, "--out", "out",
               "--progress", "none", "--set", "outputs.video=false")  # fmt: skip
    assert done.returncode == 8, done.stderr
    assert "Traceback" not in done.stderr
    assert "1 of 3 scans failed" in done.stderr
    assert "bad.obj" in done.stderr
    complete = {path.parent.name for path in (tmp_path / "out").glob("*/manifest.json")}
    assert len(complete) == 2
    assert {name.split("-")[0] for name in complete} == {"anna", "bert"}
    assert files_in(tmp_path / "out" / "bad") == set()
    for name in complete:
        folder = tmp_path / "out" / name
        manifest = json.loads((folder / "manifest.json").read_text())
        assert manifest["source"]["file"] == "model.obj"
        assert len(manifest["source"]["sha256"]) == 64
        assert {"prep", "render"} <= set(manifest["seconds"])
        assert {entry["path"] for entry in manifest["files"]} >= {
            "asset/mesh.glb", "asset/albedo.png", "contact_sheet.png", "pipeline.yaml",
        }  # fmt: skip
        size = np.ptp(load_asset(folder / "asset").mesh.positions_mm, axis=0)
        np.testing.assert_allclose(size, 200.0, rtol=0.1)
