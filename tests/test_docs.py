"""The documents agree with the code: generated pages, commands, exit codes, keys, links."""

from __future__ import annotations

import importlib.util
import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from scanrender import errors
from scanrender.buffers import CATALOGUE, buffer_spec
from scanrender.cli.main import COMMANDS
from scanrender.errors import UsageError
from scanrender.resources import shipped_pipelines, shipped_presets
from scanrender.settings.loading import load_pipeline
from scanrender.settings.schema import pipeline_schema

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
# `docs/images/demo.jpg` is a picture that `make demo` made; all other links must lead to text.
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
SECTIONS = (
    "scan", "prep", "skin", "diffusion", "curvature", "camera", "turntable", "quality", "view",
    "outputs",
)  # fmt: skip
EXIT_CODES = {0, 1, 130} | {kind.exit_code for kind in errors.ScanrenderError.__subclasses__()}


def module(path: Path) -> Any:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


@cache
def make_docs() -> Any:
    return module(ROOT / "tools" / "make_docs.py")


def code(text: str) -> str:
    """Everything that a page shows as code."""
    return "\n".join(re.findall(r"```.*?```|`[^`\n]+`|^ {4}.*$", text, re.DOTALL | re.MULTILINE))


def code_blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize(
    "name",
    [
        "configs/schema/pipeline.schema.json",
        "docs/settings.md",
        "docs/buffers.md",
        "docs/cli.md",
    ],
)
def test_generated_pages_are_fresh(name: str):
    assert name in make_docs().PAGES
    stands = (ROOT / name).read_text(encoding="utf-8")
    assert stands == make_docs().PAGES[name](), f"{name} is stale: run `make docs`"


def test_all_generated_pages_are_tested():
    assert len(make_docs().PAGES) == 4


def test_settings_page_has_every_key_with_a_sentence():
    page = (ROOT / "docs/settings.md").read_text(encoding="utf-8")
    schema = pipeline_schema()
    for model in schema["$defs"].values():
        for name, field in model["properties"].items():
            if "$ref" not in field:
                assert f"| `{name}` |" in page
                assert "description" in field or "const" in field, f"{model['title']}.{name}"
    for preset in (*shipped_presets(), *shipped_pipelines()):
        assert f"| `{preset}` |" in page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_resolve(page: Path):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if re.match(r"https?://", target):
            continue
        path = page.parent / target
        if path.suffix in {".jpg", ".png"}:
            continue
        assert path.exists(), f"{page.name} links to {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_and_options_in_pages_exist(page: Path):
    import click

    from scanrender.cli.main import cli

    shown = code(page.read_text(encoding="utf-8"))
    for name, rest in re.findall(r"\bscanrender ([a-z]+)\b([^\n`|]*)", shown):
        assert name in COMMANDS, f"scanrender {name}"
        command = cli.get_command(click.Context(cli), name)
        assert command is not None
        inner = getattr(command, "commands", {}).get(
            rest.split(maxsplit=1)[0] if rest.split() else ""
        )
        command = inner or command
        known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
        for option in re.findall(r"(?<!\S)--[a-z-]+", rest.split("#")[0]):
            assert option in known, f"scanrender {name} {option}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_make_targets_in_pages_exist(page: Path):
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for target in re.findall(r"\bmake ([a-z]+)\b", code(page.read_text(encoding="utf-8"))):
        assert target in targets, f"make {target}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_settings_named_in_pages_exist(page: Path):
    pattern = rf"\b((?:{'|'.join(SECTIONS)})(?:\.[a-z0-9_]+)+)"
    for shown in re.findall(r"`([^`\n]+)`", page.read_text(encoding="utf-8")):
        for key in re.findall(pattern, shown):
            # File names (`view.py`, `skin.exr`) look like keys.
            if key.rsplit(".", 1)[1] not in {"py", "exr", "yaml", "png", "md"}:
                assert is_setting(key), key


def is_setting(key: str) -> bool:
    schema = pipeline_schema()
    node: Any = schema
    for part in key.split("."):
        if "$ref" in node:
            node = schema["$defs"][node["$ref"].rsplit("/", 1)[1]]
        if part not in node.get("properties", {}):
            return False
        node = node["properties"][part]
    return True


@pytest.mark.parametrize("page", ["README.md", "docs/cli.md", "docs/troubleshooting.md"])
def test_every_exit_code_is_explained(page: str):
    rows = re.findall(r"^\| (\d+) \| (.+?) \|", (ROOT / page).read_text("utf-8"), re.MULTILINE)
    # A page about failures has nothing to say about success.
    assert {int(number) for number, _ in rows} | {0} == EXIT_CODES
    meanings = dict(re.findall(r"^\| (\d+) \| (.+?) \|", make_docs().exit_codes(), re.MULTILINE))
    assert dict(rows).items() <= meanings.items()


def test_readme_names_every_command():
    text = README.read_text(encoding="utf-8")
    for name in COMMANDS:
        assert f"`scanrender {name}" in text


def test_readme_pipelines_validate(tmp_path: Path):
    blocks = code_blocks(README, "yaml")
    assert blocks
    for number, block in enumerate(blocks):
        path = tmp_path / f"readme_{number}.yaml"
        path.write_text(block, encoding="utf-8")
        load_pipeline(path)


def test_readme_python_runs_up_to_the_scan():
    (block,) = code_blocks(README, "python")
    compile(block, "README.md", "exec")
    for line in block.splitlines():
        if line.startswith("from "):
            exec(line, {})


def test_troubleshooting_opens_buffers_that_exist():
    text = (ROOT / "docs/troubleshooting.md").read_text(encoding="utf-8")
    opened = re.findall(r"^\| [^|]+ \| ([^|]+) \| [^|]+ \| [^|]+ \|$", text, re.MULTILINE)
    assert len(opened) > 20
    for cell in opened:
        for name in re.findall(r"`([a-z_0-9]+)`", cell):
            inside_asset_json = name in {"axes", "units", "lost"}
            assert inside_asset_json or buffer_spec(name)


def test_buffers_page_names_every_buffer():
    text = (ROOT / "docs/buffers.md").read_text(encoding="utf-8")
    for name in CATALOGUE:
        assert f"| `{name}` |" in text
    with pytest.raises(UsageError):
        buffer_spec("no_such_buffer")


def test_decisions_are_numbered_and_whole():
    records = sorted((ROOT / "docs/decisions").glob("*.md"))
    for number, record in enumerate(records, start=1):
        text = record.read_text(encoding="utf-8")
        assert record.name.startswith(f"{number:04d}-")
        assert text.startswith(f"# {number}. ")
        for part in ("**Context.**", "**Decision.**", "**Consequence.**"):
            assert text.count(part) == 1, f"{record.name}: {part}"


def test_every_dependency_s_licence_is_stated():
    text = (ROOT / "docs/licences.md").read_text(encoding="utf-8").lower()
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    for name in re.findall(r'^  "([\w.-]+)[><=]', project, re.MULTILINE):
        assert name.lower() in text, name
