"""`scanrender report OUT`"""

from __future__ import annotations

from pathlib import Path

import click

from scanrender.cli import options


@click.command("report")
@click.argument("out", type=click.Path(path_type=Path))
@options.debug
def command(out: Path) -> None:
    """Write OUT/report.html: the page that `scanrender run --out OUT` leaves at its end, from what
    lies in the folder. Opens no GL and reads no scan."""
    from scanrender.batch.report import write_report

    click.echo(write_report(options.existing(out, "folder")))
