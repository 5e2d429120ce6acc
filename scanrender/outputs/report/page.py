"""Puts data, style and scripts into one HTML file. All text travels as JSON and is shown as text:
the name of a scan can be any string."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scanrender.files import write_text

WEB = Path(__file__).parent / "web"
SCRIPTS = ("base", "turn", "charts", "batch", "viewer", "scan", "main")


def write_page(path: Path, data: Mapping[str, Any], pixels: Mapping[str, str]) -> Path:
    """Write the page at `path`. `pixels`: by the job's id, the JSON text of what its scripts would
    otherwise load from beside the page. Raises OutputError."""
    holders = [
        f'<script type="application/json" id="pixels-{name}">{text}</script>'
        for name, text in pixels.items()
    ]
    parts = {
        "style": (WEB / "style.css").read_text(encoding="utf-8"),
        "data": safe_json(data),
        "pixels": "\n".join(holders),
        "script": "\n".join((WEB / f"{name}.js").read_text(encoding="utf-8") for name in SCRIPTS),
    }
    # One pass over the template: what is put in is never looked at again.
    pieces = (WEB / "page.html").read_text(encoding="utf-8").split("%%")
    return write_text(path, "".join(parts.get(piece, piece) for piece in pieces))


def safe_json(document: Any) -> str:
    """JSON for inside <script>: no `<`, so no tag and no comment can begin or end in it; no line
    separators, which older JavaScript took for ends of lines. NaN is refused (ValueError)."""
    text = json.dumps(document, allow_nan=False, separators=(",", ":"), ensure_ascii=False)
    for letter in "<>&\u2028\u2029":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
