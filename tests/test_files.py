"""A reader never meets a half-written file or folder, whatever goes wrong while it is written."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from scanrender import files
from scanrender.errors import OutputError
from scanrender.files import TEMPORARY_PREFIX, atomic_folder, atomic_path, write_json, write_text


def names_in(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_finished_file_appears_under_its_name_only(tmp_path: Path):
    with atomic_path(tmp_path / "deep" / "a.exr") as temporary:
        temporary.write_bytes(b"pixels")
        assert temporary.suffix == ".exr", "libraries choose the format by the suffix"
        assert names_in(tmp_path / "deep") == {temporary.name}
        assert temporary.name.startswith(TEMPORARY_PREFIX)
    assert names_in(tmp_path / "deep") == {"a.exr"}
    assert (tmp_path / "deep" / "a.exr").read_bytes() == b"pixels"


@pytest.mark.parametrize("error", [ValueError("bug"), KeyboardInterrupt(), MemoryError()])
def test_an_exception_leaves_the_old_file_and_nothing_else(tmp_path: Path, error: BaseException):
    target = tmp_path / "a.txt"
    write_text(target, "old")

    def overwrite() -> None:
        with atomic_path(target) as temporary:
            temporary.write_text("half of the new")
            raise error

    with pytest.raises(type(error)):
        overwrite()
    assert names_in(tmp_path) == {"a.txt"}
    assert target.read_text() == "old"


@pytest.mark.parametrize("error", [ValueError("bug"), KeyboardInterrupt()])
def test_an_exception_leaves_the_old_folder_and_nothing_else(tmp_path: Path, error: BaseException):
    target = tmp_path / "asset"
    target.mkdir()
    (target / "old.txt").write_text("old")

    def overwrite() -> None:
        with atomic_folder(target) as temporary:
            (temporary / "new.txt").write_text("half")
            raise error

    with pytest.raises(type(error)):
        overwrite()
    assert names_in(tmp_path) == {"asset"}
    assert names_in(target) == {"old.txt"}


def test_a_folder_is_replaced_whole(tmp_path: Path):
    for content in ("first", "second"):
        with atomic_folder(tmp_path / "asset") as temporary:
            (temporary / content).write_text(content)
    assert names_in(tmp_path) == {"asset"}
    assert names_in(tmp_path / "asset") == {"second"}


def test_the_old_folder_comes_back_when_the_new_one_cannot_take_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    target = tmp_path / "asset"
    target.mkdir()
    (target / "old.txt").write_text("old")
    really_replace = os.replace

    def replace(source: Path, destination: Path) -> None:
        if Path(destination) == target and (Path(source) / "new.txt").exists():
            raise PermissionError(13, "Permission denied")
        really_replace(source, destination)

    monkeypatch.setattr(files.os, "replace", replace)

    def overwrite() -> None:
        with atomic_folder(target) as temporary:
            (temporary / "new.txt").write_text("new")

    with pytest.raises(OutputError):
        overwrite()
    assert names_in(tmp_path) == {"asset"}
    assert names_in(target) == {"old.txt"}


def test_a_file_in_the_place_of_a_folder_is_never_replaced(tmp_path: Path):
    """`prep head.obj --out head.obj` must not cost anybody their scan."""
    scan = tmp_path / "head.obj"
    scan.write_text("v 0 0 0")

    def overwrite() -> None:
        with atomic_folder(scan) as temporary:
            (temporary / "new.txt").write_text("new")

    with pytest.raises(OutputError, match=r"head\.obj"):
        overwrite()
    assert names_in(tmp_path) == {"head.obj"}
    assert scan.read_text() == "v 0 0 0"


def test_a_file_in_the_way_of_a_parent_is_an_output_error(tmp_path: Path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError) as caught:
        write_text(tmp_path / "file" / "a.txt", "text")
    assert caught.value.exit_code == 7
    assert caught.value.fix
    assert names_in(tmp_path) == {"file"}


def test_json_refuses_what_json_cannot_say(tmp_path: Path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", {"mean": float("nan")})
    assert names_in(tmp_path) == set()
    assert write_json(tmp_path / "a.json", {"ü": 1}).read_text(encoding="utf-8").endswith("\n")


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_what_a_killed_process_left_goes_before_anybody_asked_how_it_ended(tmp_path: Path):
    """Orphans of a killed batch wait for the system's first process, which may take its time."""
    ended = subprocess.Popen([sys.executable, "-c", ""])
    while Path(f"/proc/{ended.pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z":
        time.sleep(0.01)
    own = files.temporary_name("sheet.png")
    left = tmp_path / own.replace(f"-{os.getpid()}-", f"-{ended.pid}-")
    left.touch()
    (tmp_path / own).touch()
    files.clean_stale(tmp_path)
    ended.wait()
    assert not left.exists()
    assert (tmp_path / own).exists(), "its process lives"
