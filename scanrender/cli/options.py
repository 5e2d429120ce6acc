"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from scanrender.cli.progress import KINDS
from scanrender.errors import UsageError

F = TypeVar("F", bound=Callable[..., Any])


def debug(command: F) -> F:
    return click.option("--debug", is_flag=True, help="Show tracebacks.", expose_value=False)(
        command
    )


def overrides(command: F) -> F:
    return click.option(
        "--set",
        "overrides",
        multiple=True,
        metavar="KEY=VALUE",
        help="Override one setting, e.g. --set camera.width_px=1080. Repeatable.",
    )(command)


def check(command: F) -> F:
    return click.option(
        "--check",
        is_flag=True,
        help="Look at what each pass writes, and stop at the first wrong value with its place.",
    )(command)


# What --check sets.
CHECK = "quality.check=true"


def progress(command: F) -> F:
    return click.option(
        "--progress",
        "progress_kind",
        type=click.Choice(KINDS),
        default="auto",
        show_default=True,
        help="How progress is shown, on stderr (openjd: on stdout).",
    )(command)


def as_json(command: F) -> F:
    return click.option(
        "--json", "as_json", is_flag=True, help="Print the result as one JSON document."
    )(command)


def jobs(command: F) -> F:
    return click.option(
        "--jobs",
        default=1,
        show_default=True,
        type=click.IntRange(1, 256),
        help="Scans worked on at the same time, each by a process of its own; they share the "
        "cores, and never are more than memory holds.",
    )(command)


def out(default: str) -> Callable[[F], F]:
    return click.option(
        "--out",
        type=click.Path(path_type=Path),
        default=Path(default),
        show_default=True,
        help="Folder for the results.",
    )


def count(text: str, option: str) -> int:
    """A positive whole number. Raises UsageError."""
    if not text.isdecimal() or int(text) < 1:
        raise UsageError(f"{option} {text} is no number of shots", fix=f"for example {option} 48")
    return int(text)


def frame_range(text: str | None, count: int) -> list[int] | None:
    """`a-b`, 0-based and inclusive, or one number; None for everything. Raises UsageError."""
    if text is None:
        return None
    first, dash, last = text.partition("-")
    if not first.isdigit() or (dash and not last.isdigit()):
        raise UsageError(f"--frames wants A-B, not {text!r}", fix="e.g. --frames 0-15")
    start, stop = int(first), int(last) if dash else int(first)
    if start > stop or stop >= count:
        raise UsageError(
            f"--frames {text} is outside this turntable", fix=f"its frames are 0-{count - 1}"
        )
    return list(range(start, stop + 1))


def buffer_list(text: str) -> tuple[str, ...]:
    """`all`, or names of buffers: a,b,c. Raises UsageError for one that does not exist."""
    from scanrender.buffers import buffer_spec

    names = tuple(name.strip() for name in text.split(",") if name.strip())
    for name in names:
        if name != "all":
            buffer_spec(name)
    return names


def existing(path: Path, what: str) -> Path:
    """`path`, or a UsageError in one sentence when it is not there."""
    if not path.exists():
        raise UsageError(f"no such {what}: {path}")
    return path
