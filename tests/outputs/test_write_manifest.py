"""The manifest lists what is there, truthfully, and comes last."""

from __future__ import annotations

import hashlib
import json

import pytest

from scanrender.errors import OutputError
from scanrender.files import TEMPORARY_PREFIX
from scanrender.outputs.manifest import (
    file_entries,
    hash_file,
    package_versions,
    platform_info,
    write_manifest,
)


def test_the_manifest_lists_files_with_size_and_hash(tmp_path):
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "0001.png").write_bytes(b"one")
    (tmp_path / "video.mp4").write_bytes(b"")
    (tmp_path / f"{TEMPORARY_PREFIX}0-x.png").write_bytes(b"half")
    path = write_manifest(tmp_path, {"scan": "head"})
    held = json.loads(path.read_text())
    assert held["scan"] == "head"
    assert held["files"] == [
        {"path": "frames/0001.png", "bytes": 3, "sha256": hashlib.sha256(b"one").hexdigest()},
        {"path": "video.mp4", "bytes": 0, "sha256": hashlib.sha256(b"").hexdigest()},
    ]
    assert write_manifest(tmp_path, {"scan": "head"}).read_text() == path.read_text()
    assert file_entries(tmp_path) == held["files"]  # itself left out


def test_what_json_cannot_say_is_refused_and_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match="JSON"):
        write_manifest(tmp_path, {"error": float("nan")})
    assert list(tmp_path.iterdir()) == []


def test_an_absent_file_gives_a_sentence(tmp_path):
    with pytest.raises(OutputError, match="cannot read"):
        hash_file(tmp_path / "absent")


def test_versions_and_machine_are_plain_json():
    assert "scanrender" in package_versions()
    assert platform_info()["cores"] >= 1
    json.dumps([package_versions(), platform_info()], allow_nan=False)
