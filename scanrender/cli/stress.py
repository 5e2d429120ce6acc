"""`scanrender stress`"""

from __future__ import annotations

import json
from pathlib import Path

import click

from scanrender.cli import options

PAGE = "stability.md"


@click.command("stress")
@click.option(
    "--minutes", type=float, default=5.0, show_default=True, help="How long scenes are drawn."
)
@click.option("--seed", default=0, show_default=True, help="Number of the first scene.")
@click.option(
    "--axes",
    default="all",
    show_default=True,
    help="Axes walked first: all, none, or names: fov_deg,distance.",
)
@click.option(
    "--again",
    "case",
    type=click.Path(path_type=Path),
    help="Examine only this scene, which an earlier run has written.",
)
@options.out("out/stress")
@options.as_json
@options.debug
def command(
    minutes: float, seed: int, axes: str, case: Path | None, out: Path, as_json: bool
) -> None:
    """Render extreme scenes and hold each to what must be true of any picture.

    First along each axis (size, distance, lens, light, skin, mesh …), then scenes drawn by number,
    in which many are moved at once. A scene that breaks an invariant is made as simple as it can be
    and written to OUT as YAML; OUT/stability.md sums up. Ends with exit code 5 if anything broke.
    """
    from scanrender.errors import ScanrenderError, StageError, UsageError
    from scanrender.render.device import device

    if not 0.0 <= minutes <= 1e5 or seed < 0:
        raise UsageError("--minutes and --seed are numbers from 0 on")
    if case is not None:
        _again(case)
        return
    from scanrender import __version__
    from scanrender.files import check_writable, write_text
    from scanrender.measure.stress import in_words, run_stress
    from scanrender.measure.stress_page import stress_page
    from scanrender.measure.stress_precision import precision_sections

    check_writable(out)
    names = {"all": None, "none": []}.get(axes, axes.split(","))
    stress = run_stress(
        device(), minutes, seed, names, out, lambda text: click.echo(text, err=True)
    )
    try:
        precision = precision_sections(device())
    except ScanrenderError as error:  # what is broken may break these scenes too
        precision = f"Precision could not be measured: {error.what}\n"
    write_text(out / PAGE, stress_page(stress, device().renderer, __version__, precision))
    walked = [e for walk in stress.walks.values() for _, es in walk for e in es if e.is_broken]
    summary = {
        "scenes": stress.scenes,
        "tests": len(stress.tests),
        "seconds": round(stress.seconds, 1),
        "broken": [
            {"scene": b.seed, "what": in_words(b.finding), "axes": dict(b.case.axes),
             "file": str(b.file)} for b in stress.broken
        ],
        "broken_on_axes": [
            {"what": in_words(e.outcome), "axes": dict(e.case.axes)}  # type: ignore[arg-type]
            for e in walked
        ],
        "page": str(out / PAGE),
    }  # fmt: skip
    count = len(stress.broken) + len(walked)
    if as_json:
        click.echo(json.dumps(summary, indent=2))
    else:
        click.echo(f"{stress.scenes} scenes and {len(stress.walks)} axes: {count} broken\n"
                   f"{out / PAGE}")  # fmt: skip
    if count:
        raise StageError(
            f"{count} invariants are broken",
            str(out),
            "scanrender stress --again OUT/scene_….yaml examines one of them",
        )


def _again(case: Path) -> None:
    from scanrender.errors import StageError
    from scanrender.measure.invariants import Finding
    from scanrender.measure.stress import in_words, load_case, outcome_of
    from scanrender.render.device import device

    scene, invariant = load_case(case)
    outcome = outcome_of(device(), scene, invariant)
    if isinstance(outcome, Finding):
        click.echo(in_words(outcome))
        if not outcome.holds:
            raise StageError(f"{invariant} is broken", str(case), "it is a fault: report this file")
    else:
        click.echo("it does not apply" if outcome is None else f"refused: {outcome.sentence}")
