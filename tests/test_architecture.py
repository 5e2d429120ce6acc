"""The house stands as DESIGN 1 draws it: who may import whom, sizes, passes and their shaders.

Everything is read with `ast`; nothing is imported, so that a broken module cannot hide itself.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "scanrender"
MODULES = sorted(PACKAGE.rglob("*.py"))
PASSES = PACKAGE / "render" / "passes"
SHADERS = PACKAGE / "render" / "shaders"

# A part may import parts on lower levels, and those it is allowed beside itself.
LEVEL = {
    "__main__": 8, "cli": 7, "batch": 6, "measure": 5,
    "render": 4, "reference": 4, "scan": 4, "outputs": 4, "phantom": 4,
    "settings": 3, "optics": 3, "metrics": 3, "asset": 3,
    "buffers": 2, "images": 2, "files": 1, "resources": 1, "errors": 0, "": 0,
}  # fmt: skip
GPL_OR_CHILD_ONLY = {"pymeshlab", "xatlas", "fast_simplification"}
# Shaders that no pass module of their own name draws with, and who does.
SHADERS_WITHOUT_PASS = {"contrast": "render/supersample.py", "resolve": "render/supersample.py"}
MAX_LINES = 450


def part_of(module: Path) -> str:
    relative = module.relative_to(PACKAGE)
    first = relative.parts[0]
    return "" if first == "__init__.py" else first.removesuffix(".py")


def imports_of(module: Path) -> set[str]:
    """Dotted names of everything that `module` imports, at its top or inside functions."""
    found = set()
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: relative import"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def parts_imported(module: Path) -> set[str]:
    parts = set()
    for name in imports_of(module):
        words = name.split(".")
        if words[0] == "scanrender":
            known = len(words) > 1 and words[1] in LEVEL
            parts.add(words[1] if known else "")
    return parts


def test_every_part_of_the_package_has_a_level():
    assert {part_of(module) for module in MODULES} <= set(LEVEL)


@pytest.mark.parametrize("module", MODULES, ids=lambda m: str(m.relative_to(PACKAGE)))
def test_imports_run_one_way(module: Path):
    part = part_of(module)
    for other in parts_imported(module) - {part}:
        assert LEVEL[other] < LEVEL[part], f"{part or 'scanrender'} must not import {other}"


def test_the_import_check_sees_imports_inside_functions(tmp_path: Path):
    module = tmp_path / "frame.py"
    module.write_text("def f():\n    from scanrender.scan.prepare import prepare\n")
    assert parts_imported(module) == {"scan"}
    assert LEVEL["scan"] >= LEVEL["render"], "render and scan stand side by side"


def test_optics_imports_nothing_of_ours_but_errors():
    for module in (PACKAGE / "optics").rglob("*.py"):
        assert parts_imported(module) <= {"optics", "errors"}, module


def test_only_scan_names_the_mesh_libraries():
    text_of = {module: module.read_text(encoding="utf-8") for module in MODULES}
    users = {
        module.relative_to(PACKAGE).as_posix()
        for module, text in text_of.items()
        if any(name.split(".")[0] in GPL_OR_CHILD_ONLY for name in imports_of(module))
        # A child's program is a string: it imports too.
        or any(re.search(rf"^\s*(import|from) {name}\b", text, re.M) for name in GPL_OR_CHILD_ONLY)
    }
    assert {user for user in users if not user.startswith("scan/")} <= {"cli/checks.py"}
    imported = {n.split(".")[0] for n in imports_of(PACKAGE / "cli" / "checks.py")}
    assert not imported & GPL_OR_CHILD_ONLY, "checks.py may ask in a child process only"


@pytest.mark.parametrize("module", MODULES, ids=lambda m: str(m.relative_to(PACKAGE)))
def test_modules_stay_readable(module: Path):
    lines = module.read_text(encoding="utf-8").count("\n")
    assert lines <= MAX_LINES, f"{lines} lines: split it"


def test_each_pass_has_a_shader_of_its_name_and_each_shader_a_pass():
    passes = {path.stem for path in PASSES.glob("*.py") if not path.stem.startswith("_")}
    shaders = {path.stem for path in SHADERS.glob("*.frag")}
    assert shaders - passes == set(SHADERS_WITHOUT_PASS)
    assert passes - shaders == set()


def test_vertex_shaders_and_includes_are_used():
    programs = "".join(path.read_text() for path in (PACKAGE / "render").rglob("*.py"))
    shaders = "".join(path.read_text() for path in SHADERS.iterdir())
    for path in SHADERS.glob("*.vert"):
        assert path.stem == "fullscreen" or f'vertex="{path.stem}"' in programs, path
    for path in SHADERS.glob("*.glsl"):
        assert f'#include "{path.name}"' in shaders, path


@pytest.mark.parametrize("path", sorted(SHADERS.glob("*.frag")), ids=lambda p: p.name)
def test_each_fragment_shader_begins_with_its_manual(path: Path):
    version, first = path.read_text(encoding="utf-8").splitlines()[:2]
    assert version == "#version 330 core"
    assert first.startswith(f"// {path.stem}:"), "the second line says what goes in and out"


def written_buffers(module: Path) -> set[str]:
    """Names given to `Buffer(...)`; the number in an f-string stands as 0."""
    names = set()
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Buffer":
            name = node.args[0]
            if isinstance(name, ast.Constant):
                names.add(str(name.value))
            elif isinstance(name, ast.JoinedStr):
                parts = [p.value if isinstance(p, ast.Constant) else "0" for p in name.values]
                names.add("".join(str(part) for part in parts))
    return names


def catalogued_buffers() -> set[str]:
    tree = ast.parse((PACKAGE / "buffers.py").read_text(encoding="utf-8"))
    calls = [n for n in ast.walk(tree) if isinstance(n, ast.Call)]
    specs = [call for call in calls if getattr(call.func, "id", "") == "_spec"]
    return {ast.literal_eval(call.args[0]) for call in specs}


def test_each_written_buffer_is_in_the_catalogue():
    catalogue = catalogued_buffers()
    written = set().union(*(written_buffers(module) for module in PASSES.glob("*.py")))
    assert len(written) > 15
    assert {name for name in written if not name.startswith("_")} <= catalogue


def test_docstrings_say_what_each_module_is():
    for module in MODULES:
        tree = ast.parse(module.read_text(encoding="utf-8"))
        assert not tree.body or ast.get_docstring(tree), f"{module} has no docstring"
