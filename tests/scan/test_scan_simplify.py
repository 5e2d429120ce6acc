"""Simplification: budget, error bound, detail, and what is found and mended afterwards."""

from __future__ import annotations

from dataclasses import replace

import igl
import numpy as np
import pytest
from scan_shapes import cube, grid, sphere

from scanrender.errors import StageError
from scanrender.phantom import make_head
from scanrender.scan import collapse
from scanrender.scan import simplify as module
from scanrender.scan.child import run_task
from scanrender.scan.collapse import detail_faces
from scanrender.scan.curvature import mean_curvature
from scanrender.scan.lost import sample_surface
from scanrender.scan.mend import Reference, fold_count, mended, plain_surface
from scanrender.scan.neck import close_neck
from scanrender.scan.rays import Target
from scanrender.scan.refit import noise_mm, refitted
from scanrender.scan.simplify import ATTEMPTS, simplify
from scanrender.scan.topology import boundary_loops, components, edges_of, face_areas
from scanrender.settings.prep import SimplifySettings


@pytest.fixture(scope="module")
def ball():
    return plain_surface(*sphere(100.0, 64, 128)[:2])


@pytest.fixture(scope="module")
def head():
    made = make_head(60_000)
    return plain_surface(made.positions_mm, made.faces.astype(np.int64))


def error_mm(raw, positions, faces, count=20_000):
    """99 % of each surface from the other, by other samples than the code's."""
    there = Target(raw.positions, raw.faces).nearest(sample_surface(positions, faces, count, 11))
    back = Target(positions, faces).nearest(sample_surface(raw.positions, raw.faces, count, 12))
    return max(np.percentile(there.distance, 99), np.percentile(back.distance, 99))


def sound(positions, faces):
    assert (edges_of(faces).count == 2).all()
    assert components(faces, len(positions))[0] == 1
    assert fold_count(positions, faces) == 0


def test_the_budget_stops_it_and_says_so(ball):
    settings = SimplifySettings(triangles=2000, error_mm=0.01)
    positions, faces, report = simplify(ball, settings, 60.0)
    assert 1900 <= len(faces) <= 2000
    sound(positions, faces)
    assert np.abs(np.linalg.norm(positions, axis=1) - 100.0).max() < 1.0
    assert report["stopped_by"].startswith(f"stopped by the budget: {len(faces):,} triangles")
    assert report["error_mm"] == pytest.approx(error_mm(ball, positions, faces), rel=0.15)
    assert not report["rejected"]
    assert not report["over_budget"]


def test_the_error_bound_stops_it_and_says_so(ball):
    positions, faces, report = simplify(ball, SimplifySettings(error_mm=0.3), 60.0)
    sound(positions, faces)
    error = error_mm(ball, positions, faces)
    assert 0.15 < error < 0.315, "as few as the bound allows"
    assert len(faces) < 0.25 * len(ball.faces)
    assert f"stopped by the error bound: {len(faces):,} triangles" in report["stopped_by"]


def test_nothing_is_touched_where_fewer_would_break_the_bound(ball):
    positions, faces, report = simplify(ball, SimplifySettings(error_mm=0.001), 60.0)
    np.testing.assert_array_equal(positions, ball.positions)
    np.testing.assert_array_equal(faces, ball.faces)
    assert report["method"].startswith("none")


@pytest.mark.parametrize("bound", [3.0, 8.0])
def test_a_wide_error_bound_is_used_up(ball, bound):
    """A gentle collapse stalls at 466 triangles, 0.88 mm away."""
    settings = SimplifySettings(triangles=1000, error_mm=bound)
    positions, faces, report = simplify(ball, settings, 60.0)
    sound(positions, faces)
    assert 0.7 * bound < error_mm(ball, positions, faces) < 1.05 * bound
    assert report["stopped_by"].startswith("stopped by the error bound")
    assert not report["rejected"]


def test_where_the_distance_allows_all_it_ends_before_the_surface_is_ruined():
    plane = plain_surface(*grid(lambda x, y: 0.0 * x, 21, 100.0))
    positions, faces, report = simplify(plane, SimplifySettings(error_mm=100.0), 60.0)
    assert 2 <= len(faces) < 50
    assert face_areas(positions, faces).sum() > 0.7 * 200.0**2
    assert not report["rejected"]
    assert report["stopped_by"].startswith("stopped where fewer would ruin the surface")


def test_where_no_collapse_goes_on_it_says_so(ball, monkeypatch):
    monkeypatch.setattr(
        collapse, "collapsed", lambda surface, *_: (surface.positions, surface.faces)
    )
    arrays = {"positions": ball.positions, "faces": ball.faces}
    params = {"target": 20_000, "error_mm": 9.0, "aggressiveness": (7.0, 5.0)}
    _, report = collapse.collapse_task(arrays, {**params, "detail": False, "cap": False})
    assert report["stop"] == "stalled"


@pytest.mark.parametrize("budget", [500, 2000])
def test_the_cap_of_the_neck_is_within_the_budget(head, budget):
    settings = SimplifySettings(triangles=budget, error_mm=0.001)
    positions, faces, report = simplify(head, settings, 60.0, cap=True)
    capped, added = close_neck(plain_surface(positions, faces))
    assert added > 5
    assert 0.97 * budget < len(capped.faces) <= budget
    assert report["triangles"] == [len(head.faces), len(capped.faces)]
    assert report["stopped_by"].startswith(f"stopped by the budget: {len(capped.faces):,} tri")
    assert not report["damage"]
    assert not report["over_budget"]


def test_what_fills_holes_is_within_the_budget(head, monkeypatch):
    """No two per cent above: filled holes and all."""

    def torn(surface, *args):
        positions, faces = whole(surface, *args)
        return positions, np.delete(faces, np.arange(100, len(faces), len(faces) // 12), axis=0)

    whole = collapse.collapsed
    monkeypatch.setattr(collapse, "collapsed", torn)
    arrays = {"positions": head.positions, "faces": head.faces}
    params = {"target": 2000, "error_mm": 0.001, "aggressiveness": (7.0, 5.0)}
    result, report = collapse.collapse_task(arrays, {**params, "detail": False, "cap": False})
    assert report["repaired"]["holes"] > 5
    assert len(result["faces"]) <= 2000


def test_halves_fit_and_are_as_near_as_the_whole(head):
    halves = mended(*collapse.collapsed_in_halves(head, 12_000, 7.0))
    whole = mended(*collapse.collapsed(head, 12_000, 7.0))
    assert len(halves.faces) == pytest.approx(12_000, rel=0.1)  # the cut keeps its edges
    assert len(boundary_loops(halves.faces)) == len(boundary_loops(head.faces))
    assert components(halves.faces, len(halves.positions))[0] == 1
    assert (
        fold_count(halves.positions, halves.faces) <= fold_count(whole.positions, whole.faces) + 2
    )
    near, far = (error_mm(head, x.positions, x.faces) for x in (halves, whole))
    assert near < 1.15 * far


def test_halves_that_do_not_fit_are_collapsed_as_a_whole(ball, monkeypatch):
    def moving(surface, *args, **kwargs):
        rng = np.random.default_rng(len(surface.faces))
        moved = surface.positions + rng.normal(0.0, 0.1, surface.positions.shape)
        return whole(replace(surface, positions=moved), *args, **kwargs)

    whole = collapse.collapsed
    expected = len(whole(ball, 2000, 7.0)[1])
    monkeypatch.setattr(collapse, "collapsed", moving)
    _, faces = collapse.collapsed_in_halves(ball, 2000, 7.0)
    assert len(faces) == pytest.approx(expected, rel=0.02)
    assert (edges_of(faces).count == 2).all()


def test_flat_faces_cost_nothing():
    """A box of 12 x 16^2 triangles needs 12, whatever the bound."""
    corners, faces = cube(40.0)
    positions = corners
    for _ in range(4):
        edges = edges_of(faces)
        middle = len(positions) + edges.half.reshape(3, -1)
        positions = np.concatenate([positions, positions[edges.pairs].mean(axis=1)])
        (a, b, c), (ab, bc, ca) = faces.T, middle
        faces = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    settings = SimplifySettings(error_mm=0.001)
    box, few, report = simplify(plain_surface(positions, faces), settings, 60.0)
    assert len(few) <= 24
    assert face_areas(box, few).sum() == pytest.approx(6 * 40.0**2)
    assert "error bound" in report["stopped_by"]


def test_ears_lids_and_nostrils_keep_more(head):
    """Against the same collapse without weights: closer where it bends, hardly worse elsewhere."""
    raw = Target(head.positions, head.faces)
    bend = np.abs(mean_curvature(head.positions, head.faces, 2.0))
    distance, density = {}, {}
    for detail in (False, True):
        result, report = run_task(
            "simplify",
            {"positions": head.positions, "faces": head.faces},
            {
                "target": 15000,
                "error_mm": 0.001,
                "aggressiveness": (7.0, 5.0),
                "detail": detail,
                "cap": False,
            },
            60.0,
        )
        assert not report["ruined"]
        assert not report["damage"]
        low = Target(result["positions"], result["faces"])
        points = sample_surface(head.positions, head.faces, 60_000, 5)
        bent = bend[head.faces[raw.nearest(points).face]].max(axis=1) > 0.05
        away = low.nearest(points).distance
        distance[detail] = [np.percentile(away[where], 99) for where in (bent, ~bent)]
        centre = raw.nearest(result["positions"][result["faces"]].mean(axis=1))
        density[detail] = (bend[head.faces[centre.face]].max(axis=1) > 0.05).sum()
    assert density[True] > 1.05 * density[False]
    assert distance[True][0] < 0.85 * distance[False][0]
    assert distance[True][1] < 1.10 * distance[False][1]


def test_detail_is_where_the_head_bends_and_never_most_of_it(head):
    found = detail_faces(head.positions, head.faces)
    area = face_areas(head.positions, head.faces)
    centre = head.positions[head.faces].mean(axis=1)
    beside = np.abs(centre[:, 0])
    ear = (beside > 76.0) & (np.abs(centre[:, 1] + 17.0) < 25.0) & (centre[:, 2] < 0.0)
    scalp = centre[:, 1] > 60.0
    assert area[found & ear].sum() > 0.3 * area[ear].sum()
    assert area[found & scalp].sum() < 0.02 * area[scalp].sum()
    small = sphere(5.0, 48, 96)
    assert detail_faces(*small[:2]).mean() < 0.5


def test_new_holes_are_closed_and_the_old_boundary_stays(ball):
    cap = ball.faces[(ball.positions[ball.faces][:, :, 1] < 90.0).all(axis=1)]
    raw = plain_surface(ball.positions, cap)
    assert len(boundary_loops(raw.faces)) == 1
    torn = np.delete(raw.faces, [2000, 2001, 5000], axis=0)
    simple, found = Reference(raw).validated(plain_surface(raw.positions, torn))
    assert found["repaired"]["holes"] == 2
    assert not found["damage"]
    assert len(boundary_loops(simple.faces)) == 1


def test_faces_that_look_the_wrong_way_are_turned_back(ball):
    positions = ball.positions.copy()
    pulled = [1500, 3000]
    positions[pulled] = positions[[1503, 3003]] * 0.999  # across their neighbours
    simple, found = Reference(ball).validated(replace(ball, positions=positions))
    assert found["repaired"]["flipped_faces"] >= 2
    assert found["flipped"] == 0
    assert fold_count(simple.positions, simple.faces) == 0
    np.testing.assert_allclose(np.linalg.norm(simple.positions[pulled], axis=1), 100.0, atol=0.5)


def test_what_cannot_be_mended_is_said_in_sentences(ball):
    many = ball.faces.copy()
    many[1000:1400] = many[1000:1400, ::-1]
    found = Reference(ball).validated(plain_surface(ball.positions, many))[1]
    assert any("look the wrong way" in sentence for sentence in found["damage"])
    both = plain_surface(
        np.concatenate([ball.positions, 0.3 * ball.positions + 300.0]),
        np.concatenate([ball.faces, ball.faces + len(ball.positions)]),
    )
    found = Reference(both).validated(ball)[1]
    assert found["damage"] == ["1 pieces of the surface are gone"]
    half = plain_surface(ball.positions, ball.faces[: len(ball.faces) // 2])
    found = Reference(ball).validated(mended(half.positions, half.faces))[1]
    assert any("the area changed by -" in sentence for sentence in found["ruined"])


class Recorded:
    """Stands in for the child: an answer for each attempt, by its name."""

    def __init__(self, answers, surface):
        self.answers, self.surface, self.asked = answers, surface, []

    def __call__(self, task, arrays, params, *_rest):
        attempt = next(
            a for a in ATTEMPTS
            if a.aggressiveness == params["aggressiveness"] and a.detail == params["detail"]
        )  # fmt: skip
        self.asked.append(attempt.name)
        faces, ruined, damage = self.answers[len(self.asked) - 1]
        report = {
            "ruined": ruined, "damage": damage, "error_mm": 0.1, "stop": "budget",
            "repaired": {}, "flipped": 0, "detail": None, "cap_faces": 0,
        }  # fmt: skip
        return {"positions": self.surface.positions, "faces": self.surface.faces[:faces]}, report


@pytest.mark.parametrize(
    ("answers", "asked", "kept", "rejected"),
    [
        ([(900, [], [])], 1, 900, 0),
        ([(900, [], ["2 new holes"]), (950, [], [])], 2, 950, 1),
        ([(900, [], ["2 new holes"]), (950, [], ["3 new holes", "x"])], 2, 900, 2),
        ([(1500, [], []), (1500, [], []), (990, [], [])], 3, 990, 2),
        ([(1500, [], []), (1400, [], []), (1300, [], []), (1200, [], [])], 4, 1200, 4),
        ([(900, ["nothing is left"], []), (900, [], ["1 new holes"]), (1, [], [])], 2, 900, 2),
    ],
)  # fmt: skip
def test_gentler_after_damage_and_harder_above_the_budget(
    ball, monkeypatch, answers, asked, kept, rejected
):
    child = Recorded(answers, ball)
    monkeypatch.setattr(module, "run_task", child)
    _, faces, report = simplify(ball, SimplifySettings(triangles=1000), 60.0)
    assert len(child.asked) == asked
    assert len(faces) == kept
    assert len(report["rejected"]) == rejected
    assert report["over_budget"] == (kept > 1000)


def test_a_ruined_surface_is_an_error_with_each_reason(ball, monkeypatch):
    monkeypatch.setattr(module, "run_task", Recorded([(9, ["nothing is left"], [])] * 4, ball))
    with pytest.raises(StageError, match=r"fails: in steps.*nothing is left.*hardest"):
        simplify(ball, SimplifySettings(triangles=1000), 60.0)


def test_a_crash_is_followed_by_another_attempt(ball, monkeypatch):
    def crashing(task, arrays, params, *rest):
        if params["detail"]:
            raise StageError("the stage 'simplify' crashed")
        return run_task(task, arrays, params, *rest)

    monkeypatch.setattr(module, "run_task", crashing)
    _, faces, report = simplify(ball, SimplifySettings(triangles=1000), 60.0)
    assert len(faces) <= 1000
    assert report["rejected"] == ["in steps, detail weighted: the stage 'simplify' crashed"]


def test_a_noisy_surface_is_fitted_to_its_points_and_a_border_stays():
    rng = np.random.default_rng(3)
    side, step = 61, 1.0
    x, y = np.meshgrid(np.arange(side) * step, np.arange(side) * step, indexing="ij")
    height = 6.0 * np.cos(x / 20.0) * np.cos(y / 25.0)
    exact = np.stack([x, y, height], axis=-1).reshape(-1, 3)
    noisy = exact + np.array([0.0, 0.0, 0.1]) * rng.standard_normal((len(exact), 1))
    i = np.arange(side * side).reshape(side, side)

    def grid(stride: int) -> tuple[np.ndarray, np.ndarray]:
        j = i[::stride, ::stride]
        a, b, c, d = j[:-1, :-1], j[1:, :-1], j[1:, 1:], j[:-1, 1:]
        faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
        used, faces = np.unique(faces, return_inverse=True)
        return used, faces.reshape(-1, 3)

    assert noise_mm(exact, grid(1)[1]) < 0.01
    assert noise_mm(noisy, grid(1)[1]) == pytest.approx(0.1, rel=0.1)
    used, faces = grid(4)
    tree = igl.AABB()
    tree.init(noisy[used], faces)
    moved = refitted(noisy[used], faces, noisy, tree)
    inner = (exact[used, :2] > 0.0).all(axis=1) & (exact[used, :2] < 60.0).all(axis=1)
    np.testing.assert_array_equal(moved[~inner], noisy[used][~inner])
    before, after = (
        np.sqrt(np.mean((p[inner, 2] - exact[used][inner, 2]) ** 2)) for p in (noisy[used], moved)
    )
    assert after < 0.7 * before
