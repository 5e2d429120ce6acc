"""`scanrender compare A B`"""

from __future__ import annotations

import json
from pathlib import Path
from typing import cast

import click

from scanrender.cli import options


@click.command("compare")
@click.argument("image", type=click.Path(path_type=Path))
@click.argument("reference", type=click.Path(path_type=Path))
@click.option(
    "--mask",
    type=click.Choice(["auto", "all", "subject", "skin"]),
    default="auto",
    show_default=True,
    help="Pixels that count; auto: skin where a file has that layer, else the subject.",
)
@click.option(
    "--ppd",
    type=click.FloatRange(1.0, 1000.0),
    default=67.0,
    show_default=True,
    help="Pixels per degree of whoever looks, for FLIP: 67 is a 4K screen of 0.7 m at 0.7 m.",
)
@click.option(
    "--exposure",
    type=click.FloatRange(-20.0, 20.0),
    default=0.0,
    show_default=True,
    help="Stops by which linear light is raised before it is seen.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=None,
    help="Folder for heat maps of dE2000 and FLIP; none are written without it.",
)
@options.as_json
@options.debug
def command(
    image: Path,
    reference: Path,
    mask: str,
    ppd: float,
    exposure: float,
    out: Path | None,
    as_json: bool,
) -> None:
    """Say how far IMAGE is from REFERENCE.

    EXR frames are compared by their light, PNG files as a display shows them.
    """
    from scanrender.files import make_folder
    from scanrender.measure import compare

    pictures = compare.read_picture(image), compare.read_picture(reference)
    kind = cast(compare.MaskKind, mask)  # click.Choice has checked it
    figures, maps = compare.compare_pictures(*pictures, kind, ppd, exposure)
    files = []
    if out is not None:
        make_folder(out)
        chosen, _ = compare.chosen_mask(*pictures, kind)
        files = compare.write_heat_maps(out, maps, chosen)
    if as_json:
        click.echo(json.dumps({**figures, "files": [str(file) for file in files]}, indent=2))
        return
    click.echo(f"{image} against {reference}\n{compare.in_words(figures)}")
    for file in files:
        click.echo(f"  {file}")
