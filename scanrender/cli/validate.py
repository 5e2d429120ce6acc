"""`scanrender validate PIPELINE…`"""

from __future__ import annotations

import click

from scanrender.cli import options


@click.command("validate")
@click.argument("pipelines", nargs=-1, required=True)
@options.overrides
@click.option("--resolved", is_flag=True, help="Print each with extends and defaults filled in.")
@options.debug
def command(pipelines: tuple[str, ...], overrides: tuple[str, ...], resolved: bool) -> None:
    """Check each PIPELINE (a file, or the name of a shipped one). Needs no GL and no scan."""
    from scanrender.settings.loading import load_pipeline, resolved_yaml

    for source in pipelines:
        settings = load_pipeline(source, overrides)
        click.echo(resolved_yaml(settings) if resolved else f"{source}: ok")
