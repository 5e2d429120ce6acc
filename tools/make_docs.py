"""Writes the pages that are made from the code: `make docs`.

docs/settings.md, docs/buffers.md, docs/cli.md and configs/schema/pipeline.schema.json.
`tests/test_docs.py` compares each with what stands in the repository.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
NOTICE = "<!-- Made from the code by `make docs`: do not edit. -->\n"
HELP_WIDTH = 100

Schema = Mapping[str, Any]


def schema_text() -> str:
    from scanrender.settings.schema import pipeline_schema

    return json.dumps(pipeline_schema(), indent=2, ensure_ascii=False) + "\n"


SETTINGS_INTRO = """# Settings

Every key that a pipeline file may say. Everything has a default, so a file says only what differs.
Unknown keys are refused. An editor that knows YAML schemas completes and checks these keys, from
[the JSON Schema](../configs/schema/pipeline.schema.json).

- `extends:` names files or presets that the file starts from, the later over the earlier. Mappings
  merge key by key; lists are replaced whole.
- `--set camera.width_px=1080` overrides one key on the command line; `--set lights.0.irradiance=3`
  reaches into a list.
- `scanrender validate FILE --resolved` prints the file with everything filled in. The same is saved
  as `pipeline.yaml` beside each result.
- Lengths are millimetres on the subject, angles degrees, colours linear Rec.709.
"""


def settings_page() -> str:
    schema = json.loads(schema_text())
    properties = schema["properties"]
    sections = {name: p for name, p in properties.items() if "$ref" in p}
    plain = {name: p for name, p in properties.items() if name not in sections}
    blocks = [NOTICE + SETTINGS_INTRO, "## Top of the file\n", _table(plain, schema)]
    for name, node in sections.items():
        blocks += _section(name, node, schema, 2)
        if name == "curvature":
            # Where it stands in the file: after the material, before the camera.
            blocks += ["## lights\n", f"{properties['lights']['description']}\n"]
            for option in properties["lights"]["items"]["oneOf"]:
                kind = _resolved(option, schema)["properties"]["type"]["const"]
                blocks += _section(f"lights, `type: {kind}`", option, schema, 3)
    blocks += ["## Presets\n", "For `extends:`. The files are in `configs/`.\n", _presets()]
    blocks += ["## Shipped pipelines\n", "For `scanrender run NAME SCAN`, and for `extends:`.\n"]
    blocks.append(_pipelines())
    return "\n".join(blocks)


def _section(name: str, node: Schema, schema: Schema, level: int) -> Iterator[str]:
    """Heading, sentence, table of one section; then its sections below, one level deeper."""
    model = _resolved(node, schema)
    inner = {key: p for key, p in model["properties"].items() if "$ref" in p}
    fields = {key: p for key, p in model["properties"].items() if key not in inner}
    yield f"{'#' * level} {name}\n"
    yield f"{model['description']}\n"
    if fields:
        yield _table(fields, schema)
    for key, property_ in inner.items():
        yield from _section(f"{name}.{key}", property_, schema, level + 1)
    for key, property_ in fields.items():
        for option in property_.get("anyOf", (property_,)):
            if "$ref" in option.get("items", ()):
                yield from _section(f"{name}.{key}, each item", option["items"], schema, level + 1)


def _table(fields: Schema, schema: Schema) -> str:
    rows = [
        (f"`{name}`", _type(p, schema), _default(p), _unit(p),
         _range(p), p.get("description") or "Chooses this kind.")
        for name, p in fields.items()
    ]  # fmt: skip
    return _markdown(("Key", "Type", "Default", "Unit", "Range", "Meaning"), rows)


def _unit(node: Schema) -> str:
    unit = str(node.get("unit", ""))
    return "none" if unit == "1" else unit


TYPES = {"string": "text", "boolean": "`true` or `false`", "object": "mapping"}
PLURALS = {"integer": "integers", "number": "numbers", "text": "words"}


def _type(node: Schema, schema: Schema) -> str:
    if "anyOf" in node:
        kinds = [_type(option, schema) for option in node["anyOf"] if option.get("type") != "null"]
        return " or ".join(kinds)
    if "const" in node:
        return f"`{node['const']}`"
    if "enum" in node:
        return ", ".join(f"`{word}`" for word in node["enum"])
    if "prefixItems" in node:
        return f"{len(node['prefixItems'])} numbers"
    if node["type"] == "array":
        items = node["items"]
        if "oneOf" in items:
            return "list of lights, see below"
        if "$ref" in items:
            return "list of items, see below"
        kind = _type(items, schema)
        return f"list of {PLURALS.get(kind, kind)}"
    return TYPES.get(node["type"], str(node["type"]))


def _default(node: Schema) -> str:
    if "default" not in node:
        return "must be given" if "unit" in node else ""
    value = node["default"]
    if value is None or value in ("", [], {}):
        return "none"
    if isinstance(value, list) and isinstance(value[0], dict):
        return f"{len(value)} of them"
    return f"`{_yaml(value)}`"


def _yaml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{', '.join(map(_yaml, value))}]"
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def _range(node: Schema) -> str:
    nodes = [*node.get("anyOf", ()), *node.get("prefixItems", ())[:1], node]
    for part in nodes:
        if "exclusiveMinimum" in part:
            return f"> {part['exclusiveMinimum']:g}"
        if "minimum" in part and "maximum" in part:
            return f"{_number(part['minimum'])} to {_number(part['maximum'])}"
        if "minimum" in part:
            return f"≥ {_number(part['minimum'])}"
    return ""


def _number(value: float) -> str:
    return f"{value:,.0f}" if 1e3 <= abs(value) < 1e8 else f"{value:g}"


def _resolved(node: Schema, schema: Schema) -> Any:
    return schema["$defs"][node["$ref"].rsplit("/", 1)[1]]


def _presets() -> str:
    from scanrender.resources import shipped_presets

    rows = [(f"`{name}`", _remark(path)) for name, path in shipped_presets().items()]
    return _markdown(("Preset", "What it is"), rows)


def _pipelines() -> str:
    from scanrender.resources import shipped_pipelines

    rows = [(f"`{name}`", _remark(path)) for name, path in shipped_pipelines().items()]
    return _markdown(("Pipeline", "What it does"), rows)


def _remark(path: Path) -> str:
    """The comment at the head of a YAML file; where there is none, what the file says."""
    lines = path.read_text(encoding="utf-8").splitlines()
    remarks = [line.lstrip("# ") for line in lines if line.startswith("# ")]
    remarks = [line for line in remarks if not line.startswith("yaml-language-server")]
    values = [f"`{line}`" for line in lines if line[:1] not in ("#", " ")]
    return " ".join(remarks) or ", ".join(v for v in values if not v.startswith("`version"))


BUFFERS_INTRO = """# Buffers

Every intermediate picture has a name. The names are the same in Python (`frame.buffers["albedo"]`),
in the shaders, in EXR layers and here. Ask for them with

    scanrender render ASSET --buffers position,albedo,diffuse
    scanrender run buffers SCAN

or in a pipeline with `outputs: {buffers: [position, albedo, diffuse]}`; `all` is every one that the
scene makes. Each dump is one EXR with all layers and a PNG with a legend for each buffer.

- A name that ends in 0 is a family: `shadow_1` belongs to the second light.
- Beauty is the EXR's unnamed RGBA. Other buffers are taken at the pixel's centre, without
  antialiasing ([decision 6](decisions/0006-buffers-from-pixel-centre.md)).
- Spaces: `lin_rec709_scene` is scene-linear Rec.709; `view` has the camera at the origin, looking
  along -Z, +Y up, in mm; `surface` belongs to the point seen; `light N` is seen from that light.
- False-colour pictures use the range below where there is one, else the 0.5 and 99.5 percentiles.

The pictures are of our own head under `light/portrait`, as `scanrender run buffers` shows it
(`tools/buffer_pictures.py`). A picture looks wrong? [Which buffer to open](troubleshooting.md).
"""


def buffers_page() -> str:
    from scanrender.buffers import CATALOGUE

    rows = []
    for spec in CATALOGUE.values():
        first, last = spec.channels[0], spec.channels[-1].rsplit(".", 1)[1]
        channels = f"`{first}`" if len(spec.channels) == 1 else f"`{first}` … `{last}`"
        span = "" if spec.span is None else f"{spec.span[0]:g} to {spec.span[1]:g}"
        space = f"`{spec.space}`" if "_" in spec.space else spec.space
        unit = "none" if spec.unit == "1" else spec.unit
        picture = f"![{spec.name}](images/buffers/{spec.name}.jpg)"
        words = (f"`{spec.name}`", picture, spec.healthy, spec.meaning)
        rows.append((*words, spec.kind, space, unit, channels, span))
    words = ("Buffer", "", "A healthy one", "What it holds")
    head = (*words, "Kind", "Space", "Unit", "EXR", "Range")
    return "\n".join([NOTICE + BUFFERS_INTRO, _markdown(head, rows)])


CLI_INTRO = """# Commands

What each command's `--help` says. Results go to stdout (`--json` for programs), narration to
stderr.
"""


def cli_page() -> str:
    from scanrender.cli.main import COMMANDS, cli

    width: dict[str, Any] = {"terminal_width": HELP_WIDTH, "resilient_parsing": True}
    root = cli.make_context("scanrender", [], **width)
    blocks = [NOTICE + CLI_INTRO, "## scanrender\n", _code(cli.get_help(root))]
    for name in COMMANDS:
        command = cli.get_command(root, name)
        assert command is not None
        context = command.make_context(name, [], parent=root, **width)
        blocks += [f"## scanrender {name}\n", _code(command.get_help(context))]
        for inner, below in getattr(command, "commands", {}).items():
            deeper = below.make_context(inner, [], parent=context, **width)
            blocks += [f"### scanrender {name} {inner}\n", _code(below.get_help(deeper))]
    blocks += ["## Exit codes\n", exit_codes()]
    return "\n".join(blocks)


def exit_codes() -> str:
    from scanrender import errors

    meanings = {0: "ok", 1: "a bug in scanrender", 130: "interrupted"}
    meanings |= {
        kind.exit_code: MEANINGS[kind.__name__] for kind in errors.ScanrenderError.__subclasses__()
    }
    rows = [(str(code), meanings[code]) for code in sorted(meanings)]
    return _markdown(("Code", "Meaning"), rows)


MEANINGS = {
    "UsageError": "the command line is wrong, or names a path that is not there",
    "ConfigError": "a YAML file or a `--set` is wrong",
    "ScanError": "this scan cannot be used",
    "StageError": "a stage failed, crashed, timed out, or made non-finite pixels",
    "DeviceError": "no usable OpenGL",
    "OutputError": "the output cannot be written",
    "BatchError": "several scans, and some of them failed",
}


def _code(text: str) -> str:
    lines = (line.rstrip() for line in text.splitlines())
    return "```text\n" + "\n".join(lines) + "\n```\n"


def _markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    def line(cells: Sequence[str]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    return "\n".join([line(head), "|" + "---|" * len(head), *map(line, rows)]) + "\n"


PAGES: Mapping[str, Callable[[], str]] = {
    "configs/schema/pipeline.schema.json": schema_text,
    "docs/settings.md": settings_page,
    "docs/buffers.md": buffers_page,
    "docs/cli.md": cli_page,
}


def main() -> None:
    for name, page in PAGES.items():
        path = ROOT / name
        text = page()
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
            print(f"wrote {name}")


if __name__ == "__main__":
    main()
