"""Every error of a user's is one clear answer with its exit code, and leaves nothing behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from scanrender.files import TEMPORARY_PREFIX

TRIANGLE = "v 0 0 0\nv 90 0 0\nv 0 220 0\nf 1 2 3\n"
NO_FACES = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    "property float z\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
)
# GL that cannot start, as on a server without EGL.
NO_GL = """
import moderngl
def refuse(*arguments, **options):
    raise Exception("libEGL.so.1: cannot open shared object file")
moderngl.create_context = refuse
"""
NO_GL_AT_ALL = "import sys; sys.modules['moderngl'] = None; sys.modules['glcontext'] = None"


def answer(done: subprocess.CompletedProcess[str], code: int, *words: str) -> None:
    """The process ended with `code` and said so once, in words, without a traceback."""
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr + done.stdout
    lines = done.stderr.splitlines()
    assert sum(line.startswith(("scanrender: ", "Error: ")) for line in lines) == 1, done.stderr
    for word in words:
        assert word in done.stderr
    said = [line for line in lines if not line.startswith("[")]  # progress
    assert len(said) <= 5, "what, where, what to do"


def files_in(folder: Path) -> set[str]:
    """What is left but for the log and the report, which say what happened."""
    if not folder.exists():
        return set()
    files = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
    return files - {"out/log.txt", "out/report.html"}


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    path = tmp_path / "triangle.obj"
    path.write_text(TRIANGLE)
    return path


# --- 2: the command line -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run", "turntable", "absent.obj"], ["no such scan: absent.obj"]),
        (["prep", "absent.obj"], ["no such scan: absent.obj"]),
        (["inspect", "absent.obj"], ["no such scan"]),
        (["render", "absent"], ["no such asset: absent"]),
        (["run", "turntabel", "triangle.obj"], ["turntabel", "did you mean 'turntable'?"]),
        (["validate", "nosuch.yaml"], ["nosuch.yaml", "shipped pipelines"]),
        (["run", "turntable"], ["at least one scan"]),
        (["run", "turntable", "triangle.obj", "--frames", "9-3"], ["--frames"]),
        (["run", "turntable", "triangle.obj", "--frames", "0-9999"], ["--frames", "0-95"]),
        (["run", "turntable", "triangle.obj", "--frames", "-1"], ["--frames"]),
        (["run", "turntable", "triangle.obj", "triangle.obj"], ["twice"]),
        (["run", "turntable", "triangle.obj", "--set", "camera.fill"], ["KEY=VALUE"]),
        (["render", ".", "--buffers", "positon"], ["positon"]),
        (["renders"], ["renders", "Did you mean 'render'?"]),
        (["run", "--nosuch"], ["--nosuch"]),
        (["run"], ["PIPELINE"]),
        (["run", "turntable", "triangle.obj", "--progress", "loud"], ["loud"]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_usage_errors(cli, scan: Path, tmp_path: Path, arguments: list[str], words: list[str]):
    answer(cli(*arguments, *(["--out", "out"] if arguments[0] in ("run", "prep") else [])), 2,
           *words)  # fmt: skip
    assert files_in(tmp_path) == {"triangle.obj"}


# --- 3: the configuration ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("camera:\n  witdh_px: 3\n", ["camera.witdh_px", "p.yaml:2", "did you mean 'width_px'?"]),
        ("camera: {fill: 1}\ncamera: {fill: 2}\n", ["duplicate key", "p.yaml:2"]),
        ("camera: [1\n", ["not valid YAML", "p.yaml:"]),
        ("extends: light/portait\n", ["light/portait", "p.yaml:1", "light/portrait"]),
        ("outputs: {buffers: [positon]}\n", ["positon", "p.yaml:1", "position"]),
    ],
    ids=["mistyped key", "duplicate key", "broken", "extends", "buffer"],
)
def test_config_errors(cli, scan: Path, tmp_path: Path, text: str, words: list[str]):
    (tmp_path / "p.yaml").write_text(text)
    answer(cli("run", "p.yaml", scan, "--out", "out"), 3, *words)
    assert files_in(tmp_path) == {"triangle.obj", "p.yaml"}


def test_a_wrong_override_is_shown(cli, scan: Path):
    done = cli("run", "turntable", scan, "--set", "camera.witdh_px=3")
    answer(done, 3, "--set camera.witdh_px=3", "did you mean 'width_px'?")


# --- 4: the scan ---------------------------------------------------------------------------------


@pytest.mark.gl
@pytest.mark.parametrize(
    ("name", "content"),
    [("points.ply", NO_FACES), ("empty.obj", ""), ("notes.txt", "hello"), ("text.glb", "hello"),
     ("cut.ply", NO_FACES[:60])],
)  # fmt: skip
def test_scans_that_cannot_be_used(cli, tmp_path: Path, name: str, content: str):
    (tmp_path / name).write_text(content)
    answer(cli("run", "turntable", name, "--out", "out", "--progress", "none"), 4, name)
    assert files_in(tmp_path) == {name}


@pytest.mark.gl
def test_a_broken_asset(cli, tmp_path: Path):
    (tmp_path / "asset").mkdir()
    (tmp_path / "asset" / "asset.json").write_text("{}")
    answer(cli("render", "asset", "--out", "out"), 4, "asset.json")
    assert files_in(tmp_path) == {"asset/asset.json"}


# --- 6: GL ---------------------------------------------------------------------------------------


def test_without_gl(cli, scan: Path, tmp_path: Path):
    done = cli("run", "turntable", scan, "--out", "out", code=NO_GL)
    answer(done, 6, "no usable OpenGL", "libEGL.so.1", "apt-get install", "doctor")
    assert files_in(tmp_path) == {"triangle.obj"}


def test_doctor_without_gl(cli):
    done = cli("doctor", code=NO_GL)
    assert done.returncode == 6
    assert "BAD  OpenGL" in done.stdout
    assert "apt-get install" in done.stdout
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ["validate", "turntable", "demo"],
        ["schema"],
        ["run", "turntable", "triangle.obj", "--dry-run"],
    ],
)
def test_what_needs_no_gl_does_without(cli, scan: Path, arguments: list[str]):
    done = cli(*arguments, code=NO_GL_AT_ALL)
    assert done.returncode == 0, done.stderr


# --- 7: the output -------------------------------------------------------------------------------


@pytest.mark.parametrize("command", [["run", "turntable"], ["prep"]])
def test_a_file_in_the_way_of_the_output(cli, scan: Path, tmp_path: Path, command: list[str]):
    (tmp_path / "file").write_text("in the way")
    for out in ("file/deep", "file"):
        answer(cli(*command, scan, "--out", out), 7, "file", "--out" if out != "file" else "")
    assert files_in(tmp_path) == {"triangle.obj", "file"}
    assert (tmp_path / "file").read_text() == "in the way"


@pytest.mark.skipif(os.geteuid() == 0 if hasattr(os, "geteuid") else True,
                    reason="root may write everywhere")  # fmt: skip
def test_a_folder_without_permission(cli, scan: Path, tmp_path: Path):
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    answer(cli("run", "turntable", scan, "--out", "locked"), 7, "locked")
    assert files_in(locked) == set()


def test_prep_never_replaces_a_scan_or_a_folder_of_other_things(cli, scan: Path, tmp_path: Path):
    answer(cli("prep", scan, "--out", scan), 7, "triangle.obj")
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "thesis.txt").write_text("years")
    answer(cli("prep", scan, "--out", "docs"), 7, "docs", "not an asset")
    assert files_in(tmp_path) == {"triangle.obj", "docs/thesis.txt"}
    assert scan.read_text() == TRIANGLE


# --- 1 and 130 -----------------------------------------------------------------------------------

BUG = "import scanrender.settings.loading as l\ndef load_pipeline(*a): raise KeyError('oops')\n" \
      "l.load_pipeline = load_pipeline"  # fmt: skip


def test_a_bug_of_ours_is_called_one(cli):
    answer(cli("validate", "turntable", code=BUG), 1, "bug in scanrender", "KeyError", "--debug")


def test_debug_shows_the_traceback(cli):
    done = cli("validate", "turntable", "--debug", code=BUG)
    assert done.returncode == 1
    assert "Traceback" in done.stderr


@pytest.mark.gl
def test_an_interruption_ends_with_130_and_nothing_half_written(scan: Path, tmp_path: Path):
    command = [sys.executable, "-m", "scanrender", "run", "turntable", str(scan), "--out", "out",
               "--progress", "json"]  # fmt: skip
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        first = process.stderr.readline()
        assert "ingest" in first, "preparation has begun"
        time.sleep(0.2)
        process.send_signal(signal.SIGINT)
        _, rest = process.communicate(timeout=60)
    assert process.returncode == 130, rest
    assert "interrupted" in rest
    assert "Traceback" not in rest
    left = [path.name for path in (tmp_path / "out").rglob("*")]
    assert not [name for name in left if name.startswith(TEMPORARY_PREFIX)]
    assert "manifest.json" not in left


def test_a_reader_that_goes_away_is_no_error(tmp_path: Path):
    command = f"{sys.executable} -m scanrender schema | head -c 10"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, timeout=60,
                          cwd=tmp_path, check=False)  # fmt: skip
    assert done.stdout.startswith("{")
    assert "Traceback" not in done.stderr
