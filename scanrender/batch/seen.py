"""Whether another machine is as this one: the same code and libraries, the same files by the same
paths. Plain questions and answers, so that they travel; asked before anything is done.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import uuid
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from scanrender import __version__
from scanrender.asset import is_asset
from scanrender.batch import keys
from scanrender.batch.jobs import Job
from scanrender.errors import OutputError
from scanrender.files import check_writable, clean_stale, temporary_name

_END_BYTES = 4096  # of a scan's beginning and end that are compared, beside its size


def made_by() -> dict[str, str]:
    """What results depend on besides settings and inputs (`keys`), by names for people. Read anew:
    a Dask worker lives for weeks, and its next child is whatever is installed by then."""
    keys.code_digest.cache_clear()
    keys.library_versions.cache_clear()
    found = {"scanrender": __version__}
    for stage in keys.STAGES:
        found |= keys.library_versions(stage)
    found |= {f"scanrender's code for {x}": keys.code_digest(x) for x in keys.STAGES}
    return {**found, "scanrender's code for batches": keys.sources_digest(["batch"])}


def differences(here: Mapping[str, str], there: Mapping[str, str]) -> str:
    """In words; empty where there are none."""
    names = [name for name in here if there.get(name) != here[name]]
    said = []
    for name in names:
        if " " in name:
            said.append(f"{name} is another one")
        else:
            said.append(f"{name} {there.get(name, 'none')} instead of {here[name]}")
    return ", ".join(said[:3]) + (f" and {len(said) - 3} more" if len(said) > 3 else "")


@contextlib.contextmanager
def evidence(jobs: Sequence[Job], out: Path) -> Iterator[dict[str, Any]]:
    """A question for `unseen`, which holds until the end: a file in `out` that says a word, and the
    looks of all scans and pictures. Raises OutputError."""
    check_writable(out)
    clean_stale(out)
    token, word = out.resolve() / temporary_name("seen"), uuid.uuid4().hex
    inputs = {os.path.abspath(job.scan) for job in jobs}
    inputs |= {name for job in jobs for name in job.recipe.pictures}
    try:
        token.write_text(word, encoding="utf-8")
        looks = {path: fingerprint(Path(path)) for path in sorted(inputs)}
        known = {path: look for path, look in looks.items() if look is not None}
        yield {"out": os.path.abspath(out), "token": token.name, "word": word, "looks": known}
    finally:
        token.unlink(missing_ok=True)


def unseen(question: Mapping[str, Any]) -> tuple[str, str] | None:
    """A path that is not here what it is where `evidence` was made, and what is wrong with it."""
    out = Path(question["out"])
    try:
        word = (out / question["token"]).read_text(encoding="utf-8")
    except OSError as error:
        there = "is not there" if not out.is_dir() else "is another folder"
        if not isinstance(error, FileNotFoundError):
            there = f"cannot be read ({error.strerror})"
        return str(out), there
    if word != question["word"]:
        return str(out), "is another folder"
    try:
        check_writable(out)
    except OutputError as error:
        return str(out), f"cannot be written ({error.what.rpartition(': ')[2]})"
    for path, look in question["looks"].items():
        now = fingerprint(Path(path))
        if now is None:
            return path, "is not there or cannot be read"
        if now != look:
            return path, "is another file"
    return None


def fingerprint(path: Path) -> str | None:
    """Size and both ends of a file, or of the description of a prepared scan; None without one."""
    file = path / "asset.json" if is_asset(path) else path
    try:
        with file.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            ends = stream.read(_END_BYTES)
            stream.seek(max(0, size - _END_BYTES))
            ends += stream.read(_END_BYTES)
    except OSError:
        return None
    return f"{size} {hashlib.sha256(ends).hexdigest()}"
