"""record.json: what a folder's files were made from. Resuming is finding that nothing changed.

    {"format": 1, "stages": {"prep": {"key": ..., "reads": ..., "files": {...}, "notes": ...}, ...}}

`reads` is everything that a stage's files depend on, `key` its digest. A file's entry holds size,
mtime_ns, inode and sha256: as long as the first three are as they were the content is believed,
otherwise it is looked at. The record is written after the files it names (beside, then renamed), so
that a process killed at any moment leaves files without an entry, which count as not there.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scanrender.errors import OutputError
from scanrender.files import write_text

RECORD_NAME = "record.json"
FORMAT = 1
DAMAGED = "damaged"  # a key that nothing has


@dataclass(frozen=True)
class FileEntry:
    """A file as it was when a stage wrote or read it. `part` is the frame it belongs to, if any."""

    size: int
    mtime_ns: int
    inode: int
    sha256: str
    part: int | None = None

    def as_json(self) -> dict[str, Any]:
        data = {"size": self.size, "mtime_ns": self.mtime_ns, "inode": self.inode}
        return {**data, "sha256": self.sha256, **({} if self.part is None else {"part": self.part})}


def read_entry(path: Path, part: int | None = None) -> FileEntry:
    """The entry of the file at `path`, hashed now. Raises OutputError when it cannot be read, or
    changes while it is."""
    try:
        with path.open("rb") as stream:
            before = os.fstat(stream.fileno())
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
            after = os.fstat(stream.fileno())
    except OSError as error:
        raise OutputError(f"cannot read {path}: {error.strerror}", str(path)) from error
    if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
        raise OutputError(f"{path} changed while it was read", str(path), "run it again")
    return FileEntry(after.st_size, after.st_mtime_ns, after.st_ino, digest, part)


def checked(path: Path | str, entry: FileEntry, verify: bool = False) -> FileEntry | None:
    """The entry that is true of the file now, if its content is what `entry` says; else None.

    Size, time and inode are believed unless `verify`; where they differ the content decides: a
    copied folder is as good as the first.
    """
    try:
        stat = os.stat(path)
    except OSError:
        return None
    if stat.st_size != entry.size:
        return None
    if not verify and (stat.st_mtime_ns, stat.st_ino) == (entry.mtime_ns, entry.inode):
        return entry
    with suppress(OutputError):
        now = read_entry(Path(path), entry.part)
        return now if now.sha256 == entry.sha256 else None
    return None


@dataclass
class Stage:
    """One stage's entry: what its files were made from, the files, and what it told.

    `inputs` are files that it read and did not write; the caller knows the folder they are in.
    """

    key: str
    reads: dict[str, Any]
    files: dict[str, FileEntry] = field(default_factory=dict)
    inputs: dict[str, FileEntry] = field(default_factory=dict)
    seconds: float = 0.0
    notes: dict[str, Any] = field(default_factory=dict)

    def parts(self) -> dict[int, list[str]]:
        """Names of the files of each frame."""
        found: dict[int, list[str]] = {}
        for name, entry in self.files.items():
            if entry.part is not None:
                found.setdefault(entry.part, []).append(name)
        return found

    def forget(self, names: Iterable[str]) -> None:
        """Files that are not there any more. A stage is whole or not, but for frames."""
        for name in list(names):
            entry = self.files.pop(name, None)
            if entry is None or entry.part is None:
                self.key = DAMAGED


@dataclass
class Record:
    """The record of one folder; `save` writes it when something changed."""

    folder: Path
    stages: dict[str, Stage] = field(default_factory=dict)
    changed: bool = False

    def put(self, name: str, stage: Stage) -> Stage:
        self.stages[name] = stage
        self.changed = True
        return stage

    def drop(self, name: str) -> None:
        if self.stages.pop(name, None) is not None:
            self.changed = True

    def current(self, name: str, key: str) -> Stage | None:
        """The stage's entry if it was made from the same."""
        stage = self.stages.get(name)
        return stage if stage is not None and stage.key == key else None

    def damaged(self, stage: Stage, names: Iterable[str], verify: bool = False) -> str | None:
        """The first of these files of the stage that is gone or not what it wrote. Then all of them
        are forgotten: they are made together."""
        names, folder = list(names), str(self.folder)
        for name in names:
            entry = stage.files.get(name)
            now = None if entry is None else checked(f"{folder}/{name}", entry, verify)
            if now is None:
                stage.forget(names)
                self.changed = True
                return name
            stage.files[name] = now
            self.changed |= now is not entry
        return None

    def hashes(
        self, stage: Stage, base: Path, names: Iterable[str], verify: bool = False
    ) -> dict[str, str]:
        """sha256 of files that the stage reads, relative to `base`; known ones are believed as long
        as size, time and inode are. Raises OutputError for one that is gone."""
        found = {}
        for name in names:
            entry = stage.inputs.get(name)
            now = None if entry is None else checked(base / name, entry, verify)
            if now is None:
                now = read_entry(base / name)
            self.changed |= now is not entry
            stage.inputs[name] = now
            found[name] = now.sha256
        return found

    def add(self, stage: Stage, name: str, part: int | None = None) -> None:
        """Note that the stage has written the file."""
        stage.files[name] = read_entry(self.folder / name, part)
        self.changed = True

    def save(self) -> None:
        if not self.changed:
            return
        stages = {
            name: {
                "key": stage.key,
                "reads": stage.reads,
                "seconds": round(stage.seconds, 3),
                "notes": stage.notes,
                "inputs": {file: entry.as_json() for file, entry in sorted(stage.inputs.items())},
                "files": {file: entry.as_json() for file, entry in sorted(stage.files.items())},
            }
            for name, stage in self.stages.items()
        }
        document = {"format": FORMAT, "stages": stages}
        write_text(self.folder / RECORD_NAME, json.dumps(document, indent=1, allow_nan=False))
        self.changed = False


def load_record(folder: Path) -> Record:
    """The folder's record; an empty one where there is none that can be read."""
    record = Record(folder)
    try:
        document = json.loads((folder / RECORD_NAME).read_text(encoding="utf-8"))
        if document["format"] == FORMAT:
            record.stages = {
                str(name): Stage(
                    str(stage["key"]),
                    dict(stage["reads"]),
                    {_own(file): FileEntry(**entry) for file, entry in stage["files"].items()},
                    {str(file): FileEntry(**entry) for file, entry in stage["inputs"].items()},
                    float(stage["seconds"]),
                    dict(stage["notes"]),
                )
                for name, stage in document["stages"].items()
            }
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return Record(folder)  # damaged, or of another program: nothing is known
    return record


def _own(name: str) -> str:
    """The name of a file of the record's folder: a record may come from anybody, and its files are
    removed when they are stale. Raises ValueError."""
    parts = name.split("/")  # not pathlib: a thousand records name a hundred thousand files
    if not name or parts[0] == "" or ".." in parts:
        raise ValueError(name)
    return name


def digest(reads: Mapping[str, Any]) -> str:
    """A key: equal for equal content, whatever the order of its mappings."""
    text = json.dumps(reads, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:24]


def differences(then: Any, now: Any, path: str = "") -> list[str]:
    """What differs between two `reads`, in words: `settings.skin.scale: 1.0 is now 0.5`."""
    if isinstance(then, Mapping) and isinstance(now, Mapping):
        found = []
        for name in [*then, *(name for name in now if name not in then)]:
            inner = f"{path}.{name}" if path else str(name)
            found += differences(then.get(name), now.get(name), inner)
        return found
    if isinstance(then, list) and isinstance(now, list) and len(then) == len(now):
        pairs = enumerate(zip(then, now, strict=True))
        return [x for i, (a, b) in pairs for x in differences(a, b, f"{path}.{i}")]
    if then == now:
        return []
    return [f"{path}: {_short(then)} is now {_short(now)}"]


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    is_hash: Callable[[str], bool] = lambda t: len(t) >= 24 and set(t) <= set("0123456789abcdef")  # noqa: E731
    if is_hash(text):
        return text[:8]
    return text if len(text) <= 60 else f"{text[:57]}..."
