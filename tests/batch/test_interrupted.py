"""What earlier runs left, half done or of other settings, is taken over or goes."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import sys
from pathlib import Path

import pytest
from batch.jobs import Counted, contents, flip_a_bit, silent, tiny

from scanrender.batch.job import run_job
from scanrender.batch.record import RECORD_NAME, load_record

pytestmark = pytest.mark.gl


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
        if stage == "render":
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
        if stage == "render" and len(seen) % 40 in (30, 31):
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
