"""`scanrender schema`"""

from __future__ import annotations

import json

import click

from scanrender.cli import options


@click.command("schema")
@options.debug
def command() -> None:
    """Print the JSON Schema of pipeline files: each field's unit, range and meaning."""
    from scanrender.settings.schema import pipeline_schema

    click.echo(json.dumps(pipeline_schema(), indent=2, ensure_ascii=False))
