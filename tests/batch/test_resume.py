"""What is complete is not done again, what is not is; and nobody can tell afterwards."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest
from render.synthetic import pipeline, sphere, sphere_mesh

from scanrender.asset import save_asset
from scanrender.batch import job as batch_job
from scanrender.batch.job import run_job
from scanrender.batch.jobs import single_job
from scanrender.batch.record import RECORD_NAME, load_record
from scanrender.batch.state import Trust, look, records_of
from scanrender.batch.upkeep import verify_jobs
from scanrender.render.frame import Renderer
from scanrender.scan import prepare as preparation
from scanrender.settings.pipeline import Pipeline

TINY = {
    "stages": ["prep", "render"],
    "scan": {"units": "mm"},
    "prep": {
        "simplify": {"triangles": 150}, "report": "short",
        "bake": {"albedo_px": 32, "normal_px": 32, "data_px": 16, "ao_rays": 4,
                 "thickness_rays": 1},
    },
    "camera": {"width_px": 32, "height_px": 32},
    "turntable": {"frames": 4},
    "quality": {"supersampling": 1},
    "lights": [{"type": "directional", "shadow_px": 64}],
    "outputs": {"frames": True, "buffers": ["albedo"], "buffer_frames": [1]},
}  # fmt: skip
OTHER_LIGHT = [{"type": "directional", "shadow_px": 64, "azimuth_deg": 80}]


def tiny(**changes: Any) -> Pipeline:
    return pipeline(TINY, **changes)


def silent(stage: str, fraction: float) -> None:
    pass


def write_ball(path: Path, radius: float = 100.0, head: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    ball = sphere_mesh(radius, 8)
    lines = [head] if head else []
    lines += [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in ball.positions_mm]
    lines += [f"vt {u:.5f} {v:.5f}" for u, v in ball.uv]
    lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in ball.faces + 1]
    path.write_text("\n".join(lines) + "\n")
    return path


class Counted:
    """How often a scan was prepared, and which frames were rendered."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.prepared, self.rendered = 0, []
        prepare, render = preparation.prepare, Renderer.render

        def counted_prepare(*arguments, **keywords):
            self.prepared += 1
            return prepare(*arguments, **keywords)

        def counted_render(renderer, view, *arguments, **keywords):
            self.rendered.append(view.index)
            return render(renderer, view, *arguments, **keywords)

        monkeypatch.setattr(preparation, "prepare", counted_prepare)
        monkeypatch.setattr(Renderer, "render", counted_render)

    def since(self) -> tuple[int, list[int]]:
        found = self.prepared, self.rendered
        self.prepared, self.rendered = 0, []
        return found


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counted:
    return Counted(monkeypatch)


@pytest.fixture(scope="module")
def asset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("asset") / "ball"
    return save_asset(sphere(20.0, (0.6, 0.3, 0.2), rings=10), folder)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A raw scan, `ball.obj`, and `out`, its finished job; copied by those that change it."""
    folder = tmp_path_factory.mktemp("finished")
    run_job(write_ball(folder / "ball.obj"), tiny(), folder / "out", silent)
    return folder


@pytest.fixture
def work(finished: Path, tmp_path: Path) -> Path:
    shutil.copytree(finished, tmp_path / "w")  # with its times; the inodes are others
    return tmp_path / "w"


def contents(folder: Path) -> dict[str, bytes]:
    """Everything but what tells times."""
    telling = {RECORD_NAME, "log.txt", "manifest.json", "asset.json", "prep_report.json"}
    files = [path for path in folder.rglob("*") if path.is_file() and path.name not in telling]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def flip_a_bit(path: Path) -> None:
    """As a bad disk does: size, time and inode stay."""
    stat = path.stat()
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    with path.open("r+b") as file:
        file.write(data)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


pytestmark = pytest.mark.gl


def test_a_finished_job_is_not_touched(work: Path, counted: Counted):
    before = {path: path.stat().st_mtime_ns for path in work.rglob("*") if path.is_file()}
    result = run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert result.cached
    assert counted.since() == (0, [])
    after = {path: path.stat().st_mtime_ns for path in work.rglob("*") if path.is_file()}
    changed = {path.name for path in before if before[path] != after.get(path)}
    assert set(after) == set(before)
    assert changed <= {RECORD_NAME}, "the copy's inodes are noted, nothing else"
    manifest = json.loads((work / "out" / "manifest.json").read_text())
    assert set(result.files) >= {"asset/", "turntable.mp4", "manifest.json"}
    assert {entry["path"] for entry in manifest["files"]} >= {"asset/mesh.glb", "turntable.mp4"}


def test_a_copied_folder_is_believed_by_its_content_once(work: Path, monkeypatch):
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    from scanrender.batch import record

    def refuse(path: Path, part: int | None = None) -> None:
        raise AssertionError(f"{path} was read again")

    monkeypatch.setattr(record, "read_entry", refuse)
    assert run_job(work / "ball.obj", tiny(), work / "out", silent).cached


def test_another_light_renders_without_preparing(work: Path, counted: Counted):
    before = contents(work / "out")
    run_job(work / "ball.obj", tiny(lights=OTHER_LIGHT), work / "out", silent)
    assert counted.since() == (0, [0, 1, 2, 3])
    after = contents(work / "out")
    assert {n for n in before if before[n] != after[n] and n.startswith("asset/")} == set()
    assert before["turntable.mp4"] != after["turntable.mp4"]
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert contents(work / "out") == before


@pytest.mark.parametrize(
    ("changes", "prepared", "rendered"),
    [
        ({"description": "words"}, 0, []),
        ({"turntable": {"fps": 12}}, 0, []),  # frames are kept: the video is made of them
        ({"outputs": {"contact_frames": 2}}, 0, []),
        ({"outputs": {"buffers": ["albedo", "position"]}}, 0, [1]),
        ({"outputs": {"buffer_frames": [1, 3]}}, 0, [3]),
        ({"prep": {"memory_mib": 4000}}, 0, []),
        ({"skin": {"scale": 0.5}}, 0, [0, 1, 2, 3]),
        # Another preparation of the same maps: frames are keyed by what is in them.
        ({"prep": {"timeout_s": 800}}, 1, []),
        ({"prep": {"simplify": {"triangles": 140}}}, 1, [0, 1, 2, 3]),
    ],
    ids=str,
)
def test_only_what_reads_a_setting_is_done_again(
    work: Path, counted: Counted, changes: dict[str, Any], prepared: int, rendered: list[int]
):
    settings = tiny(**changes)
    run_job(work / "ball.obj", settings, work / "out", silent)
    assert counted.since() == (prepared, rendered)
    assert run_job(work / "ball.obj", settings, work / "out", silent).cached


@pytest.mark.parametrize("name", ["frames/frame_0002.png", "buffers/frame_0001/albedo.png"])
def test_a_file_that_is_gone_is_made_again_alone(work: Path, counted: Counted, name: str):
    before = contents(work / "out")
    (work / "out" / name).unlink()
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert counted.since() == (0, [2] if name.startswith("frames") else [1])
    assert contents(work / "out") == before


def test_without_kept_frames_a_lost_video_renders_them_again(asset: Path, tmp_path: Path, counted):
    settings = tiny(outputs={"frames": False, "buffers": []})
    run_job(asset, settings, tmp_path, silent)
    before = contents(tmp_path)
    assert not (tmp_path / ".frames").exists()
    counted.since()
    (tmp_path / "turntable.mp4").unlink()
    run_job(asset, settings, tmp_path, silent)
    assert counted.since() == (0, [0, 1, 2, 3])
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("name", "prepared", "rendered"),
    [
        ("frames/frame_0001.png", 0, [1]),
        ("turntable.mp4", 0, []),
        ("buffers/frame_0001.exr", 0, [1]),
        ("asset/albedo.png", 1, []),
    ],
)
def test_a_flipped_bit_is_found_by_verify_and_made_again_alone(
    work: Path, counted: Counted, name: str, prepared: int, rendered: list[int]
):
    before = contents(work / "out")
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    flip_a_bit(work / "out" / name)
    assert run_job(work / "ball.obj", tiny(), work / "out", silent).cached, "nobody has looked"
    batch_job.do_job(single_job(work / "ball.obj", tiny(), work / "out"), silent, verify=True)
    assert counted.since() == (prepared, rendered)
    assert contents(work / "out") == before


@pytest.mark.parametrize(
    ("name", "stage"),
    [("asset/ao.exr", "prep"), ("buffers/frame_0001.exr", "buffers"), ("turntable.mp4", "video")],
)
def test_what_verify_forgets_stays_forgotten(work: Path, name: str, stage: str):
    """Also when the record is written in between: what is left of a stage is not the stage."""
    flip_a_bit(work / "out" / name)
    _, damaged = verify_jobs(work / "out")
    assert damaged == [str(work / "out" / name)]
    job = single_job(work / "ball.obj", tiny(), work / "out")
    for _ in range(2):
        records = records_of(job)
        assert stage in look(job, records, Trust()).reasons
        records.job.changed = True
        records.save()


def test_what_a_stage_reads_is_looked_at(work: Path, counted: Counted):
    """A damaged map is found before it is shown, a damaged frame before it is in the video."""
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    before = contents(work / "out")
    flip_a_bit(work / "out" / "asset" / "albedo.png")
    (work / "out" / "frames" / "frame_0000.png").unlink()
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert counted.since() == (1, [0])
    flip_a_bit(work / "out" / "frames" / "frame_0003.png")
    (work / "out" / "turntable.mp4").unlink()
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert counted.since() == (0, [3])
    assert contents(work / "out") == before


def test_another_scan_and_a_changed_one_are_prepared(work: Path, counted: Counted):
    write_ball(work / "ball.obj", radius=90.0)
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert counted.since()[0] == 1
    write_ball(work / "other.obj", radius=90.0)
    run_job(work / "other.obj", tiny(), work / "out", silent)
    assert counted.since() == (1, []), "the same shape: its frames are there"


def test_a_scan_that_is_only_touched_is_not_prepared(work: Path, counted: Counted):
    os.utime(work / "ball.obj")
    assert run_job(work / "ball.obj", tiny(), work / "out", silent).cached
    assert counted.since() == (0, [])


def test_an_image_that_comes_is_prepared_and_its_frames_are_rendered(work: Path, counted: Counted):
    from PIL import Image

    Image.new("RGB", (8, 8), (255, 0, 0)).save(work / "photo.png")
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert counted.since() == (1, [0, 1, 2, 3])
    manifest = json.loads((work / "out" / "manifest.json").read_text())
    assert len(manifest["source"]["beside"]["photo.png"]) == 64
    Image.new("RGB", (8, 8), (0, 0, 255)).save(work / "photo.png")
    run_job(work / "ball.obj", tiny(), work / "out", silent)
    assert counted.since() == (1, [0, 1, 2, 3])
    assert run_job(work / "ball.obj", tiny(), work / "out", silent).cached


# --- interrupted ---------------------------------------------------------------------------------


@pytest.mark.parametrize("keeps_frames", [True, False])
def test_frames_of_a_run_that_was_stopped_are_not_rendered_again(
    asset: Path, tmp_path: Path, counted: Counted, keeps_frames: bool
):
    settings = tiny(outputs={"frames": keeps_frames}, turntable={"frames": 6})
    run_job(asset, settings, tmp_path / "whole", silent)
    counted.since()

    def stop(stage: str, fraction: float) -> None:
        if fraction > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_job(asset, settings, tmp_path / "out", stop)
    done = counted.since()[1]
    assert not (tmp_path / "out" / "manifest.json").exists()
    assert not (tmp_path / "out" / "turntable.mp4").exists()
    run_job(asset, settings, tmp_path / "out", silent)
    assert counted.since()[1] == [i for i in range(6) if i not in done]
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


def test_frames_that_waited_for_a_video_do_not_stay(asset: Path, tmp_path: Path):
    """The run was stopped, and then frames were asked for instead."""

    def stop(stage: str, fraction: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_job(asset, tiny(outputs={"frames": False}), tmp_path, stop)
    assert (tmp_path / ".frames").exists()
    run_job(asset, tiny(), tmp_path, silent)
    assert not (tmp_path / ".frames").exists()
    assert run_job(asset, tiny(), tmp_path, silent).cached


def test_files_without_an_entry_count_as_not_there(asset: Path, tmp_path: Path, counted: Counted):
    """A process that is killed between writing frames and noting them."""
    run_job(asset, tiny(), tmp_path, silent)
    before = contents(tmp_path)
    record = load_record(tmp_path)
    for name in [name for name, entry in record.stages["frames"].files.items() if entry.part]:
        del record.stages["frames"].files[name]
    record.changed = True
    record.save()
    (tmp_path / "manifest.json").unlink()
    (tmp_path / "frames" / "frame_0003.png").write_bytes(b"half of a pict")
    counted.since()
    run_job(asset, tiny(), tmp_path, silent)
    assert counted.since()[1] == [1, 2, 3]
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"format": 9}', '{"format": 1, "stages": {"prep": 1}}']
)
def test_a_record_that_cannot_be_read_is_no_record(
    asset: Path, tmp_path: Path, counted: Counted, text: str
):
    run_job(asset, tiny(), tmp_path, silent)
    before = contents(tmp_path)
    counted.since()
    (tmp_path / RECORD_NAME).write_text(text)
    run_job(asset, tiny(), tmp_path, silent)
    assert counted.since()[1] == [0, 1, 2, 3]
    assert contents(tmp_path) == before


def test_a_record_names_no_file_outside_its_folder(asset: Path, tmp_path: Path):
    """Stale files are removed: a record from somebody else must not choose which."""
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    run_job(asset, tiny(), tmp_path / "out", silent)
    path = tmp_path / "out" / RECORD_NAME
    for name in ("../mine.txt", str(mine)):
        document = json.loads(path.read_text())
        entry = next(iter(document["stages"]["video"]["files"].values()))
        document["stages"]["video"]["files"] = {name: entry}
        path.write_text(json.dumps(document))
        run_job(asset, tiny(skin={"scale": 0.5}), tmp_path / "out", silent)
        run_job(asset, tiny(), tmp_path / "out", silent)
        assert mine.read_text() == "mine"


def test_results_of_other_settings_do_not_stay_beside_these(asset: Path, tmp_path: Path):
    run_job(asset, tiny(turntable={"frames": 6}), tmp_path, silent)
    run_job(asset, tiny(), tmp_path, silent)
    run_job(asset, tiny(), tmp_path / "fresh", silent)
    fresh = contents(tmp_path / "fresh")
    shutil.rmtree(tmp_path / "fresh")
    assert contents(tmp_path) == fresh


def test_parts_of_a_turn_are_found_by_the_whole(asset: Path, tmp_path: Path, counted: Counted):
    """A farm renders ranges; whoever makes the video of them renders nothing twice."""
    run_job(asset, tiny(), tmp_path / "whole", silent)
    for part in ([0, 1], [2, 3]):
        run_job(asset, tiny(), tmp_path / "parts", silent, frames=part)
    assert not (tmp_path / "parts" / "turntable.mp4").exists()
    counted.since()
    run_job(asset, tiny(), tmp_path / "parts", silent)
    assert counted.since() == (0, [])
    assert contents(tmp_path / "parts") == contents(tmp_path / "whole")


def test_parts_of_other_machines_are_taken_over(work: Path, counted: Counted):
    """Rendered from the asset's folder, into folders of their own, one of them damaged since."""
    out, expected = work / "farm", contents(work / "out")
    run_job(work / "ball.obj", tiny(stages=["prep"]), out, silent)
    for part in ([0, 1], [2], [3]):
        run_job(out / "asset", tiny(), out / "parts" / str(part[0]), silent, frames=part)
    flip_a_bit(out / "parts" / "2" / "frames" / "frame_0002.png")
    other = tiny(skin={"scale": 0.5})
    run_job(out / "asset", other, out / "parts" / "other", silent, frames=[0, 1, 2, 3])
    counted.since()
    run_job(work / "ball.obj", tiny(), out, silent)
    # Frame 1 again for its buffers, which nobody takes over.
    assert counted.since() == (0, [1, 2])
    shutil.rmtree(out / "parts")
    assert contents(out) == expected
    assert run_job(work / "ball.obj", tiny(), out, silent).cached


def test_a_driver_that_changed_renders_everything_again(
    asset: Path, tmp_path: Path, counted: Counted
):
    """Frames of two drivers in one turn would flicker."""
    run_job(asset, tiny(), tmp_path, silent)
    record = load_record(tmp_path)
    frames = record.stages["frames"]
    from scanrender.batch.record import digest

    frames.reads["gl"] = "another | 1.0"
    old = frames.key
    frames.key = digest(frames.reads)
    for name in ("video", "sheet", "buffers"):
        stage = record.stages[name]
        assert stage.reads["frames"] == old
        stage.reads["frames"] = frames.key
        stage.key = digest(stage.reads)
    record.changed = True
    record.save()
    counted.since()
    assert run_job(asset, tiny(), tmp_path, silent).cached, "which driver there is nobody asked"
    (tmp_path / "frames" / "frame_0002.png").unlink()
    run_job(asset, tiny(), tmp_path, silent)
    assert counted.since()[1] == [0, 1, 2, 3]


def test_a_plan_is_made_once(asset: Path, tmp_path: Path, counted: Counted, monkeypatch):
    """It is measured, with times too: a run that goes on must go on with the same settings."""
    from scanrender.batch import shot

    made = []
    prepare_shot = shot.prepare_shot

    def counted_shot(*arguments, **keywords):
        made.append(1)
        return prepare_shot(*arguments, **keywords)

    monkeypatch.setattr(shot, "prepare_shot", counted_shot)
    settings = tiny(quality={"preset": "draft"})
    first = run_job(asset, settings, tmp_path, silent)
    assert made == [1]
    assert first.quality["picked"]
    (tmp_path / "frames" / "frame_0002.png").unlink()
    counted.since()
    again = run_job(asset, settings, tmp_path, silent)
    assert made == [1]
    assert counted.since()[1] == [2]
    assert again.quality["picked"] == first.quality["picked"]
    assert again.decisions == first.decisions


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_neither_gl_objects_nor_file_handles_grow_with_frames(asset: Path, tmp_path: Path):
    """The driver is asked which of the names it has given out are still alive."""
    from scanrender.render.device import device

    library = ctypes.CDLL("libGL.so.1")
    is_alive = [library.glIsTexture, library.glIsFramebuffer, library.glIsBuffer]
    seen: list[tuple[int, ...]] = []

    def look_around(stage: str, fraction: float) -> None:
        if len(seen) % 40 in (30, 31):
            context = device().context
            newest = context.texture((1, 1), 1)
            newest.release()
            names = range(1, 4 * newest.glo + 400)
            alive = [sum(bool(ask(name)) for name in names) for ask in is_alive]
            seen.append((*alive, len(os.listdir("/proc/self/fd"))))
        else:
            seen.append(())

    settings = tiny(turntable={"frames": 220}, outputs={"frames": False, "buffers": []})
    run_job(asset, settings, tmp_path, look_around)
    counts = [numbers for numbers in seen if numbers]
    assert len(counts) > 8
    assert counts[0][0] > 5, "otherwise nobody was asked"
    assert all(numbers[:3] == counts[0][:3] for numbers in counts)
    assert max(numbers[3] for numbers in counts) <= min(n[3] for n in counts) + 4, (
        "files that are being written are open now and then"
    )
