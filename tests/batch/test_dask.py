"""The same jobs on a Dask cluster: real schedulers, workers and deaths, and the same pixels."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from batch.dask_cluster import Cluster, until
from batch.killing import KILL
from batch.test_resume import write_ball
from render.synthetic import sphere

from scanrender.asset import save_asset

pytest.importorskip("distributed")
pytestmark = [
    pytest.mark.gl,
    pytest.mark.skipif(sys.platform != "linux", reason="reads /proc"),
]

# Enough frames to be killed between the first and the last.
PIPELINE = """\
version: 1
scan: {units: mm}
prep:
  simplify: {triangles: 150}
  report: short
  bake: {albedo_px: 32, normal_px: 32, data_px: 16, ao_rays: 4, thickness_rays: 1}
camera: {width_px: 32, height_px: 32}
turntable: {frames: 40}
quality: {supersampling: 1}
lights: [{type: directional, shadow_px: 64}]
outputs: {frames: true, buffers: [position], buffer_frames: [0]}
"""


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    found = Cluster(tmp_path_factory.mktemp("cluster"))
    yield found
    found.stop()
    assert KILL.marked(found.mark) == [], "nothing outlives the cluster"


@pytest.fixture(scope="module")
def assets(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("assets")
    ball = sphere(20.0, (0.6, 0.3, 0.2), rings=10)
    return [str(save_asset(ball, folder / name / "asset")) for name in ("anna", "bert", "carl")]


@pytest.fixture(scope="module")
def expected(assets: list[str], tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What a local run makes."""
    folder = tmp_path_factory.mktemp("expected")
    batch = KILL.Batch([pipeline_file(folder), *assets, "--jobs", "2"], folder / "out")
    batch.run()
    found: dict[str, str] = KILL.contents(batch.out)
    return found


def pipeline_file(folder: Path, text: str = PIPELINE) -> str:
    path = folder / "tiny.yaml"
    path.write_text(text)
    return str(path)


def batch_of(folder: Path, scans: list[str], scheduler: str, *words: str) -> Any:
    said = ["--scheduler", scheduler, "--progress", "json", *words]
    return KILL.Batch([pipeline_file(folder), *scans, *said], folder / "out")


def log_of(batch: Any) -> str:
    return Path(f"{batch.out}.log").read_text()


def renders(batch: Any) -> bool:
    return '"render"' in log_of(batch)


def test_a_worker_killed_in_the_middle_costs_one_try(
    cluster: Cluster, assets: list[str], expected: dict[str, str], tmp_path: Path
):
    victim = cluster.at_least(2)[0]
    batch = batch_of(tmp_path, assets, cluster.address)
    running = batch.start()
    until(lambda: renders(batch), running)  # both have a scan by now
    victim.send_signal(signal.SIGKILL)
    victim.wait()
    assert running.wait() == 0, log_of(batch)
    assert "was lost in the stage" in log_of(batch)
    assert "trying again (2 left)" in log_of(batch)
    assert KILL.contents(batch.out) == expected
    assert batch.traces() == []
    assert cluster.children() == []
    assert cluster.scratch() == []
    summary = json.loads((batch.out / "batch.json").read_text())
    assert summary["counts"] == {"jobs": 3, "failed": 0, "complete": 3}
    assert (batch.out / "report.html").exists()


def test_tries_are_bounded_and_the_others_complete(
    cluster: Cluster, assets: list[str], tmp_path: Path
):
    """The process that does the tasks dies, as it does on one machine: so are the words."""
    cluster.at_least(1)
    batch = batch_of(tmp_path, assets, cluster.address, "--retries", "0")
    running = batch.start()
    until(lambda: renders(batch), running)
    os.kill(KILL.marked(cluster.mark, "scanrender.batch.worker")[0], signal.SIGKILL)
    assert running.wait() == 8, log_of(batch)
    [failure, *others] = json.loads((batch.out / "batch.json").read_text())["jobs"]
    assert failure["status"] == "failed"
    assert "the worker died (SIGKILL) in the stage" in failure["error"]["what"]
    assert failure["error"]["exit_code"] == 5
    assert "log.txt, on " in failure["error"]["where"], "the machine is named"
    assert "memory" in failure["error"]["fix"]
    assert [job["status"] for job in others] == ["done", "done"]
    assert batch.traces() == []
    assert cluster.children() == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_when_the_command_ends_its_tasks_end(
    cluster: Cluster, assets: list[str], expected: dict[str, str], tmp_path: Path, number: int
):
    cluster.at_least(1)
    batch = batch_of(tmp_path, assets, cluster.address)
    running = batch.start()
    until(lambda: renders(batch), running)
    running.send_signal(number)
    code = running.wait()
    if number == signal.SIGINT:
        assert code == 130, log_of(batch)
        assert "Traceback" not in log_of(batch)
    else:  # what it began may not have stopped yet when the next one begins
        batch.run()
        assert KILL.contents(batch.out) == expected
    assert batch.traces() == []
    until(lambda: not cluster.children())
    assert cluster.scratch() == []


def test_a_scan_in_two_looks_is_prepared_once(cluster: Cluster, tmp_path: Path):
    cluster.at_least(2)
    matrix = "matrix: {look: {plain: {}, dim: {lights.0.irradiance: 0.5}}}\n"
    pipeline = pipeline_file(tmp_path, PIPELINE.replace("frames: 40", "frames: 2") + matrix)
    scan = write_ball(tmp_path / "ball.obj")
    done = run(tmp_path, pipeline, scan, "--out", "out", "--scheduler", cluster.address)
    assert "2 done, 0 complete before, 0 failed" in done.stdout
    logs = "".join(path.read_text() for path in (tmp_path / "out").rglob("log.txt"))
    assert logs.count("to do: prep") == 1


def test_local_starts_a_cluster_and_ends_it(
    assets: list[str], expected: dict[str, str], tmp_path: Path
):
    batch = batch_of(tmp_path, assets, "local", "--jobs", "2")
    batch.run()
    assert KILL.contents(batch.out) == expected
    assert batch.traces() == []
    assert "distributed" not in log_of(batch), "Dask's own words are not for users"


def test_ctrl_c_in_a_terminal_reaches_a_local_cluster_too(assets: list[str], tmp_path: Path):
    """A terminal sends it to every process of the command; only the command may answer."""
    batch = batch_of(tmp_path, assets, "local", "--jobs", "2")
    running = batch.start(start_new_session=True)
    until(lambda: renders(batch), running)
    os.killpg(running.pid, signal.SIGINT)
    assert running.wait() == 130, log_of(batch)
    assert "Traceback" not in log_of(batch)
    assert batch.traces() == []


def test_one_scan_alone_has_its_own_exit_code(cluster: Cluster, tmp_path: Path):
    cluster.at_least(1)
    (tmp_path / "bad.obj").write_text("this is no mesh\n")
    said = run(
        tmp_path, pipeline_file(tmp_path), "bad.obj", "--out", "out", "--scheduler",
        cluster.address, code=4,
    )  # fmt: skip
    assert "bad.obj" in said.stderr
    assert said.stderr.count("to do:") == 1, "its error is told once"
    assert not (tmp_path / "out" / ".scanrender.lock").exists()


# --- what is refused before anything starts ------------------------------------------------------


def run(folder: Path, *words: object, code: int = 0) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [sys.executable, "-m", "scanrender", "run", *map(str, words)],
        capture_output=True, text=True, cwd=folder, check=False,
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    return done


def test_a_worker_that_does_not_see_the_folder_is_named(
    cluster: Cluster, assets: list[str], tmp_path: Path
):
    """A mount of its own hides a folder from a worker, as another machine would."""
    out = tmp_path / "out"
    out.mkdir()
    mount = ["unshare", "--mount", "sh", "-c", f'mount -t tmpfs none "{out}" && exec "$@"', "sh"]
    if subprocess.run([*mount, "true"], capture_output=True, check=False).returncode:
        pytest.skip("a mount of one's own takes rights that are not there")
    worker = cluster.start_worker(before=mount)
    try:
        words = [pipeline_file(tmp_path), *assets, "--out", out, "--scheduler", cluster.address]
        said = run(tmp_path, *words, code=2).stderr
    finally:
        worker.send_signal(signal.SIGKILL)
        worker.wait()
    assert f"does not see {out}: it is another folder" in said
    assert f" on {os.uname().nodename} " in said
    assert "same path" in said
    assert list(out.iterdir()) == [], "nothing has begun"


def test_another_installation_is_refused(cluster: Cluster, assets: list[str], tmp_path, cli):
    cluster.at_least(1)
    here = "import scanrender.batch.seen as seen; seen.__version__ = '0.0.1'"
    words = ["run", pipeline_file(tmp_path), *assets, "--scheduler", cluster.address]
    done = cli(*words, code=here)
    assert done.returncode == 2, done.stderr
    assert "is another installation: scanrender " in done.stderr
    assert "instead of 0.0.1" in done.stderr
    assert "constraints.txt" in done.stderr


def test_nobody_answers(assets: list[str], tmp_path: Path):
    started = time.monotonic()
    words = [pipeline_file(tmp_path), *assets, "--scheduler", "tcp://127.0.0.1:9"]
    said = run(tmp_path, *words, code=2).stderr
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in said
    assert "dask scheduler" in said
    assert time.monotonic() - started < 60, "Dask alone would go on asking"
    assert not (tmp_path / "out").exists() or list((tmp_path / "out").rglob("*")) == []


@pytest.mark.parametrize("address", ["farm", "http://farm:8786", "tcp://farm", "tcp://farm:no"])
def test_what_is_no_address(assets: list[str], tmp_path: Path, address: str):
    said = run(tmp_path, pipeline_file(tmp_path), *assets, "--scheduler", address, code=2).stderr
    assert f"--scheduler {address} is no address" in said


def test_without_distributed(assets: list[str], tmp_path: Path, cli):
    words = ["run", pipeline_file(tmp_path), *assets, "--scheduler", "local"]
    done = cli(*words, code="import sys; sys.modules['distributed'] = None")
    assert done.returncode == 2, done.stderr
    assert "pip install 'scanrender[dask]'" in done.stderr


def test_a_dry_run_asks_nobody(assets: list[str], tmp_path: Path, cli):
    code = (
        "import atexit, sys\n"
        "atexit.register(lambda: print('dask' in sys.modules, 'distributed' in sys.modules))"
    )
    words = ["run", pipeline_file(tmp_path), *assets, "--scheduler", "tcp://127.0.0.1:9"]
    done = cli(*words, "--dry-run", code=code)
    assert done.returncode == 0, done.stderr
    assert "3 to do" in done.stdout
    assert done.stdout.endswith("False False\n"), "and Dask is not even loaded"
