"""What is installed: exact pins for everything declared, and the data that the wheel carries."""

from __future__ import annotations

import importlib.metadata
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

import scanrender

ROOT = Path(__file__).parents[1]
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def pins() -> dict[str, Version]:
    found = {}
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            match = re.fullmatch(r"([A-Za-z0-9._-]+)==([0-9][\w.]*)", line)
            assert match, f"constraints.txt has name==version only, not {line!r}"
            name = canonicalize_name(match[1])
            assert name not in found, f"{name} is pinned twice"
            found[name] = Version(match[2])
    return found


def declared() -> list[Requirement]:
    project = PROJECT["project"]
    texts = [
        *project["dependencies"],
        *(text for extra in project["optional-dependencies"].values() for text in extra),
        *PROJECT["build-system"]["requires"],
    ]
    return [Requirement(text) for text in texts]


@pytest.mark.parametrize("requirement", declared(), ids=lambda requirement: requirement.name)
def test_declared_dependency_is_bounded_and_pinned_within_its_range(requirement: Requirement):
    operators = {part.operator for part in requirement.specifier}
    assert operators == {">=", "<"}, "a lower and an upper bound"
    pinned = pins().get(canonicalize_name(requirement.name))
    assert pinned is not None, f"{requirement.name} is not in constraints.txt"
    assert requirement.specifier.contains(pinned)


def test_every_pinned_package_is_needed_and_nothing_needed_is_left_out():
    """Walks what is installed from what is declared, with the extras that are asked for."""
    todo = [(canonicalize_name(found.name), frozenset(found.extras)) for found in declared()]
    seen = set(todo)
    while todo:
        package, extras = todo.pop()
        try:
            requires = importlib.metadata.requires(package) or []
        except importlib.metadata.PackageNotFoundError:
            continue  # the build back end, in an environment that was installed without it
        for requirement in map(Requirement, requires):
            marker = requirement.marker
            applies = marker is None or any(
                marker.evaluate({"extra": extra, "python_version": python})
                for extra in ("", *extras)
                for python in ("3.11", "3.12", "3.13")
            )
            found = (canonicalize_name(requirement.name), frozenset(requirement.extras))
            if applies and found not in seen:
                seen.add(found)
                todo.append(found)
    needed = {name for name, _ in seen}
    assert needed <= set(pins()), "pin these in constraints.txt"
    # What builds the package is not walked everywhere, see above.
    build = {"editables", "trove-classifiers", "tomlkit", "pathspec", "pluggy", "packaging"}
    # Nor is importlib-metadata, which Dask asks for on Python 3.11 alone.
    older = {"zipp", "lazy-importer"}
    assert set(pins()) - build - older <= needed, "nothing needs these pins"


def test_installed_versions_are_the_pinned_ones():
    wrong = {}
    for name, pinned in pins().items():
        try:
            installed = Version(importlib.metadata.version(name))
        except importlib.metadata.PackageNotFoundError:
            continue
        if installed != pinned:
            wrong[name] = f"{installed}, pinned {pinned}"
    assert not wrong, "the tests ran with other versions: run `make venv`"


def test_wheel_carries_pipelines_presets_and_shaders():
    included = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    assert included == {
        "pipelines": "scanrender/data/pipelines",
        "configs": "scanrender/data/configs",
    }
    for folder in included:
        assert list((ROOT / folder).rglob("*.yaml"))
    assert (ROOT / "configs/schema/pipeline.schema.json").is_file()
    assert list((ROOT / "scanrender/render/shaders").glob("*.frag"))
    assert (ROOT / "scanrender/py.typed").is_file()
    # An ignored file would be missing from the wheel without a word.
    ignored = (ROOT / ".gitignore").read_text(encoding="utf-8").split()
    assert all(line.startswith(("/", ".", "*", "__")) for line in ignored)


def test_files_that_the_metadata_names_exist():
    assert (ROOT / PROJECT["project"]["readme"]).stat().st_size > 1000
    for name in PROJECT["project"]["license-files"]:
        assert "the scanrender authors" in (ROOT / name).read_text(encoding="utf-8")


def test_version_has_an_entry_in_the_changelog():
    assert f"## [{scanrender.__version__}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", ["find_python.sh", "system_packages.sh", "../.ci/run"])
def test_scripts_can_be_run(name: str):
    path = ROOT / "tools" / name
    assert path.stat().st_mode & 0o111
    assert path.read_text(encoding="utf-8").startswith("#!/usr/bin/env bash\n")
