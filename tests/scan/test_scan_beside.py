"""What a scan's reading asked of the files beside it has the same answer later, or is a change."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image
from scan_shapes import sphere, write_obj

from scanrender.errors import ScanError
from scanrender.scan import beside
from scanrender.scan.ingest import read_scan


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    positions, faces, uv = sphere(100.0, 6, 12)
    path = write_obj(tmp_path / "ball.obj", positions, faces, uv)
    text = "".join(
        x for x in path.read_text().splitlines(True) if x[:6] not in ("mtllib", "usemtl")
    )
    for file in tmp_path.iterdir():
        file.unlink()
    path.write_text(f"mtllib ball.mtl\nusemtl skin\n{text}")
    return path


def read(path: Path) -> dict:
    for notes in (beside.NOTES.found, beside.NOTES.missing, beside.NOTES.lone):
        notes.clear()
    beside.forget()
    read_scan(path)
    said = beside.answers(path)
    assert beside.changed(path, said) is None, "nothing has changed yet"
    return said


def change(path: Path, said: dict) -> str:
    beside.forget()
    return beside.changed(path, said) or ""


def write(path: Path, rgb: tuple[int, int, int] = (200, 90, 80)) -> None:
    Image.new("RGB", (8, 8), rgb).save(path)


def test_a_material_file_an_image_and_a_guess_that_come_are_changes(scan: Path):
    folder = scan.parent
    said = read(scan)
    assert said["files"] == []
    (folder / "ball.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    assert change(scan, said) == "ball.mtl is there now"
    said = read(scan)
    assert [entry["file"] for entry in said["files"]] == ["ball.mtl"]
    write(folder / "Skin.PNG")
    assert "skin.png is there now" in change(scan, said)
    said = read(scan)
    assert {entry["file"] for entry in said["files"]} == {"ball.mtl", "Skin.PNG"}
    assert len(said["files"][0]["sha256"]) == 64
    write(folder / "second.png")
    (folder / "third.obj").write_text("v 0 0 0\n")
    assert change(scan, said) == "", "nobody asked"


def test_the_image_that_was_guessed_may_be_another(scan: Path):
    folder = scan.parent
    said = read(scan)
    write(folder / "photo.png")
    assert change(scan, said) == "the image beside it is photo.png instead of None"
    said = read(scan)
    assert said["lone_image"] == "photo.png"
    write(folder / "second.png")
    assert "gone" in change(scan, said), "which of two it is nobody can tell"
    (folder / "second.png").unlink()
    assert change(scan, said) == ""
    (folder / "other.obj").write_text("v 0 0 0\n")
    assert "gone" in change(scan, said), "it may belong to the other scan"
    (folder / "other.obj").unlink()
    (folder / "photo.png").unlink()
    assert change(scan, said) != ""


def test_a_file_that_changes_while_it_is_read_is_no_input(scan: Path):
    write(scan.parent / "photo.png")
    for notes in (beside.NOTES.found, beside.NOTES.missing, beside.NOTES.lone):
        notes.clear()
    read_scan(scan)
    write(scan.parent / "photo.png", (0, 0, 0))
    with pytest.raises(ScanError, match="changed while"):
        beside.answers(scan)


@pytest.mark.parametrize("name", ["a\0b.png", "x" * 5000, "x" * 300 + "/y.png", "/etc/passwd",
                                  "../ball.obj/..", ""])  # fmt: skip
def test_names_of_no_file_are_no_files(scan: Path, name: str):
    assert change(scan, {"missing": [name]}) == ""


def test_percent_encoding_is_understood(scan: Path):
    write(scan.parent / "my skin.png")
    assert "is there now" in change(scan, {"missing": ["my%20skin.png"]})
