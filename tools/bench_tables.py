"""Puts measured tables into docs: `python tools/bench_tables.py OUT/bench`.

OUT/bench holds prep.json and fidelity.json, for docs/preparation.md, render.json and flicker.json,
for docs/rendering.md, plan.json, for docs/trade/plan.md, truth.json, published.json and
choice.json, for docs/trade/promises.md, batch.json, for docs/batch.md, as `scanrender bench` wrote
them; each may be missing.
Frames of a GPU go to a table of their own. A page keeps what stands between its marks until it is
given new figures.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"

Document = Mapping[str, Any]


def prep_blocks(document: Document) -> dict[str, str]:
    from scanrender.measure.prep_bench import LINES
    from scanrender.measure.tables import case_table, markdown, stage_table

    rows = document["rows"]
    stages = [
        f"### {row['case']}: {row['meaning']}\n\n{markdown(stage_table(row))}"
        for row in rows
        if "failed" not in row
    ]
    cases = f"{_machine(document)}\n\n{markdown(case_table(rows, LINES))}\n\n{_missed(rows)}"
    return {"cases": cases, "stages": "\n\n".join(stages)}


def fidelity_blocks(document: Document) -> dict[str, str]:
    from scanrender.measure.fidelity import FIDELITY_LINES
    from scanrender.measure.tables import case_table, markdown

    table = markdown(case_table(document["rows"], FIDELITY_LINES))
    return {"fidelity": f"{_machine(document)}\n\n{table}\n\n{_missed(document['rows'])}"}


def render_blocks(document: Document) -> dict[str, str]:
    from scanrender.measure.render_bench import render_tables
    from scanrender.measure.tables import markdown

    rows = document["rows"]
    tables = [markdown(table) for table in render_tables(rows)]
    renderer = rows[0]["renderer"]
    device = f"{_machine(document)} GL: {renderer}."
    block = "render" if "llvmpipe" in renderer else "render_gpu"
    return {block: "\n\n".join([device, *tables, _missed(rows)])}


def flicker_blocks(document: Document) -> dict[str, str]:
    from scanrender.measure.flicker import LINES
    from scanrender.measure.tables import case_table, markdown

    return {"flicker": markdown(case_table(document["rows"], LINES))}


def plan_blocks(document: Document) -> dict[str, str]:
    from scanrender.measure.plan_bench import TOLERANCE, plan_tables
    from scanrender.measure.tables import markdown

    rows = document["rows"]
    over = [f"{row['case']} ({row['p95']:.2f})" for row in rows if row["p95"] > TOLERANCE]
    found = f"{len(over)} of {len(rows)} shots are over the tolerance"
    sentence = f"{found}{': ' + ', '.join(over) if over else ''}."
    spread, left_out = map(markdown, plan_tables(rows))
    parts = [f"{_machine(document)} GL: {rows[0]['renderer']}.", spread, sentence, left_out]
    return {"plan": "\n\n".join(parts)}


def truth_blocks(document: Document) -> dict[str, str]:
    from scanrender.measure.tables import markdown
    from scanrender.measure.truth_bench import truth_table

    rows = document["rows"]
    truth = rows[0]["truth"]
    made = (
        f"The truth took {truth['seconds']:.0f} s; half the spacing of its samples moves it by "
        f"dE2000 {truth['halving_dE2000']['mean']:.3f}."
    )
    device = f"{_machine(document)} GL: {rows[0]['renderer']}. {made}"
    return {"truth": "\n\n".join([device, markdown(truth_table(rows)), _missed(rows)])}


def published_blocks(document: Document) -> dict[str, str]:
    from scanrender.measure.published_bench import published_table
    from scanrender.measure.tables import markdown

    rows = document["rows"]
    device = f"{_machine(document)} GL: {rows[0]['renderer']}."
    return {"published": "\n\n".join([device, markdown(published_table(rows)), _missed(rows)])}


def choice_blocks(document: Document) -> dict[str, str]:
    from scanrender.measure.choice_bench import choice_tables
    from scanrender.measure.tables import markdown

    table, sentence = choice_tables(document["rows"])
    return {"choice": "\n\n".join([_machine(document), markdown(table), f"{sentence}."])}


def batch_blocks(document: Document) -> dict[str, str]:
    from scanrender.measure.batch_bench import LINES
    from scanrender.measure.tables import case_table, markdown

    rows = document["rows"]
    meant = "\n".join(f"- `{row['case']}`: {row['meaning']}." for row in rows)
    table = markdown(case_table(rows, LINES))
    return {"batch": "\n\n".join([_machine(document), meant, table, _missed(rows)])}


def _machine(document: Document) -> str:
    machine = document["machine"]
    load = machine["load"]
    busy = "" if load is None else f", load {load[0]:.1f} at the end"
    name = machine["processor"] or machine["system"]
    return f"scanrender {document['scanrender']}, {machine['cores']} cores of {name}{busy}."


def _missed(rows: Any) -> str:
    from scanrender.measure.limits import missed_limits

    sentences = [f"- Over its limit: {sentence}." for sentence in missed_limits(rows)]
    return "\n".join(sentences) or "All limits are kept."


def with_blocks(page: str, blocks: Mapping[str, str]) -> str:
    """The page with each block between `<!-- NAME -->` and `<!-- end of NAME -->`.

    Raises ValueError when the page lacks a mark.
    """
    for name, text in blocks.items():
        pattern = re.compile(rf"(<!-- {name} -->\n).*?(<!-- end of {name} -->)", re.DOTALL)
        if not pattern.search(page):
            raise ValueError(f"the page has no mark <!-- {name} -->")
        page = pattern.sub(lambda found, text=text: f"{found[1]}\n{text}\n\n{found[2]}", page)  # type: ignore[misc]
    return page


BLOCKS = {
    "prep": ("preparation.md", prep_blocks),
    "fidelity": ("preparation.md", fidelity_blocks),
    "render": ("rendering.md", render_blocks),
    "flicker": ("rendering.md", flicker_blocks),
    "plan": ("trade/plan.md", plan_blocks),
    "truth": ("trade/promises.md", truth_blocks),
    "published": ("trade/promises.md", published_blocks),
    "choice": ("trade/promises.md", choice_blocks),
    "batch": ("batch.md", batch_blocks),
}


def main(folder: Path) -> None:
    for name, (page, blocks) in BLOCKS.items():
        file = folder / f"{name}.json"
        if file.exists():
            text = (DOCS / page).read_text(encoding="utf-8")
            filled = with_blocks(text, blocks(json.loads(file.read_text(encoding="utf-8"))))
            (DOCS / page).write_text(filled, encoding="utf-8")
            print(f"{file} -> docs/{page}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/bench"))
