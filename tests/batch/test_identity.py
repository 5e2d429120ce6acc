"""Names of result folders: unique whatever the scans are called, the same in every run."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanrender.batch.identity import scan_ids

NAME = st.text("abAB .-_é/", min_size=1, max_size=6).filter(lambda s: s.strip(" ./") != "")


@given(st.lists(st.tuples(NAME, NAME, st.sampled_from(["obj", "ply"])), unique=True, max_size=8))
def test_ids_are_unique_safe_and_stable(parts):
    paths = [Path("/scans") / parent / f"{stem}.{suffix}" for parent, stem, suffix in parts]
    paths = list({path.resolve(): path for path in paths}.values())
    ids = scan_ids(paths)
    assert len({name.lower() for name in ids}) == len(paths), "also on disks that fold case"
    assert ids == scan_ids(paths)
    for name in ids:
        assert name
        assert not set(name) & set('/\\:*?"<>| ')
        assert name.strip(".") == name


def test_a_name_of_its_own_is_the_stem():
    assert scan_ids([Path("a/head one.obj"), Path("b/bust.ply")]) == ["head_one", "bust"]


def test_the_same_name_takes_the_parents_and_a_hash():
    first, second = scan_ids([Path("/x/anna/model.obj"), Path("/x/bert/model.obj")])
    assert first.startswith("anna-model-")
    assert second.startswith("bert-model-")
    same_parent = scan_ids([Path("/x/anna/model.obj"), Path("/y/anna/model.obj")])
    assert len(set(same_parent)) == 2


def test_an_id_does_not_depend_on_the_order():
    paths = [Path("/x/a/model.obj"), Path("/x/b/model.obj"), Path("/x/b/bust.obj")]
    assert dict(zip(paths, scan_ids(paths), strict=True)) == dict(
        zip(paths[::-1], scan_ids(paths[::-1]), strict=True)
    )


@pytest.mark.parametrize("name", ["...", "   .obj", "ü.obj", "😀.obj"])
def test_odd_names_still_give_a_folder(name: str):
    assert scan_ids([Path(name)])[0]
