"""Puts measured tables into docs/preparation.md: `python tools/bench_tables.py OUT/bench`.

OUT/bench holds prep.json and fidelity.json as `scanrender bench` wrote them; either may be missing.
The page keeps what stands between its marks until it is given new figures.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "preparation.md"

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


def main(folder: Path) -> None:
    page = PAGE.read_text(encoding="utf-8")
    for name, blocks in (("prep", prep_blocks), ("fidelity", fidelity_blocks)):
        file = folder / f"{name}.json"
        if file.exists():
            page = with_blocks(page, blocks(json.loads(file.read_text(encoding="utf-8"))))
            print(f"{file} -> {PAGE.relative_to(ROOT)}")
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out/bench"))
