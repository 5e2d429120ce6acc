"""`scanrender inspect SCAN`"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from scanrender.cli import options


@click.command("inspect")
@click.argument("scan", type=click.Path(path_type=Path))
@options.overrides
@options.as_json
@options.debug
def command(scan: Path, overrides: tuple[str, ...], as_json: bool) -> None:
    """Say what is in SCAN: counts, size and units with their reason, holes, pieces, colours."""
    from scanrender.settings.loading import load_pipeline

    settings = load_pipeline("prep_only", overrides)
    options.existing(scan, "scan")
    from scanrender.scan.inspect import inspect_scan

    health = inspect_scan(scan, settings.scan)
    if as_json:
        click.echo(json.dumps(health, indent=2))
    else:
        _print(health, 0)


def _print(value: Any, depth: int) -> None:
    for key, item in value.items():
        name = "  " * depth + str(key).replace("_", " ")
        if isinstance(item, dict):
            click.echo(f"{name}:")
            _print(item, depth + 1)
        elif isinstance(item, list | tuple):
            click.echo(f"{name}: {', '.join(_text(part) for part in item) or 'none'}")
        else:
            click.echo(f"{name}: {_text(item)}")


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
