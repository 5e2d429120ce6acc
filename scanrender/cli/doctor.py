"""`scanrender doctor`"""

from __future__ import annotations

import json
import sys

import click

from scanrender.cli import options


@click.command("doctor")
@options.as_json
@options.debug
def command(as_json: bool) -> None:
    """Say what GL device, versions and filters are there. Exit 6 without a usable GL."""
    from scanrender.cli.checks import run_checks
    from scanrender.errors import DeviceError

    checks = run_checks()
    if as_json:
        click.echo(json.dumps([check.as_json() for check in checks], indent=2))
    else:
        for check in checks:
            click.echo(f"{'ok  ' if check.ok else 'BAD '} {check.name}: {check.found}")
            if check.fix:
                click.echo(f"      to do: {check.fix}")
    bad = [check.exit_code for check in checks if not check.ok]
    # Without GL nothing renders: that answer comes before any other.
    sys.exit(DeviceError.exit_code if DeviceError.exit_code in bad else max(bad, default=0))
