"""`scanrender plan PIPELINE SCAN`"""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from scanrender.cli import options

if TYPE_CHECKING:
    from scanrender.render.measured_plan import MeasuredPlan

USUAL_TOLERANCE = 1.0


@click.command("plan")
@click.argument("pipeline")
@click.argument("scan", type=click.Path(path_type=Path))
@options.overrides
@options.out("out/plan")
@click.option(
    "--explain", is_flag=True, help="Write a heat map of what each change would do to the picture."
)
@options.as_json
@options.debug
def command(
    pipeline: str,
    scan: Path,
    overrides: tuple[str, ...],
    out: Path,
    explain: bool,
    as_json: bool,
) -> None:
    """Measure what the turntable of PIPELINE can leave out for SCAN, and what that saves.

    SCAN is a scan, which is prepared into OUT/asset first, or a prepared folder. Each line names a
    setting, a cheaper value, what it changes (dE2000 of 95 % of the subject or of the worst part of
    it, whichever is more) and the tolerance: quality.tolerance_delta_e, or 1. `run` does the same
    for itself where the pipeline states a tolerance.
    """
    from scanrender.asset import is_asset, load_asset
    from scanrender.batch.job import RENDERED_MAPS
    from scanrender.batch.needed import unread_maps, with_needed_maps
    from scanrender.batch.shot import as_data
    from scanrender.errors import ScanrenderError
    from scanrender.render.device import device
    from scanrender.render.frame import Renderer
    from scanrender.render.measured_plan import measure_plan
    from scanrender.settings.loading import load_pipeline

    def say(text: str) -> None:
        click.echo(text, err=True)

    settings = with_needed_maps([load_pipeline(pipeline, overrides)])[0]
    options.existing(scan, "scan")
    gl = device()
    if not is_asset(scan):
        from scanrender.scan.prepare import prepare

        say(f"preparing {scan}")
        try:
            prepare(scan, settings.scan, settings.prep, out / "asset", maps=())
        except ScanrenderError:
            with contextlib.suppress(OSError):  # something else is in it: that stays
                out.rmdir()
            raise
        scan = out / "asset"
    renderer = Renderer(gl, load_asset(scan, RENDERED_MAPS), settings)
    tolerance = settings.quality.tolerance_delta_e or USUAL_TOLERANCE
    found = measure_plan(renderer, range(settings.turntable.frames), tolerance, say)
    if explain:
        for file in _heat_maps(out, found):
            say(str(file))
    decisions = [*renderer.decisions, *unread_maps(settings)]
    if as_json:
        not_run = [{"what": d.what, "reason": d.reason} for d in decisions]
        click.echo(json.dumps({**as_data(found), "not_run": not_run}, indent=2))
        return
    for decision in decisions:
        click.echo(f"not needed: {decision.what}: {decision.reason}")
    for finding in found.findings:
        click.echo(f"{'left out' if finding.is_left_out else 'kept'}: {finding.what}: "
                   f"{finding.sentence}")  # fmt: skip
    click.echo(_summary(found))


def _summary(found: MeasuredPlan) -> str:
    if found.final is None:
        return f"a frame takes {found.asked_ms:.0f} ms, and nothing can be left out of it"
    return (
        f"a frame takes {found.planned_ms:.0f} ms instead of {found.asked_ms:.0f} "
        f"({found.asked_ms / found.planned_ms:.1f} times), off by dE2000 "
        f"{found.final.delta_e:.2f}; planned in {found.seconds:.1f} s"
    )


def _heat_maps(out: Path, found: MeasuredPlan) -> list[Path]:
    """OUT/NN_setting_value.png of each finding, and OUT/final.png."""
    from scanrender.measure.compare import HEAT_DE
    from scanrender.outputs.falsecolour import false_colour_png

    shown = {
        f"{number:02d}_{f.what}_{f.value}": f.difference for number, f in enumerate(found.findings)
    }
    if found.final is not None:
        shown["final"] = found.final
    return [
        false_colour_png(out / f"{name}.png", HEAT_DE, difference.heat, difference.alpha)
        for name, difference in shown.items()
    ]
