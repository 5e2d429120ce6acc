"""Who of a cluster gets which task, and who gets none; decided without a cluster."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from render.synthetic import pipeline, sphere

from scanrender.asset import save_asset
from scanrender.batch import seen
from scanrender.batch.dask_crew import Crew
from scanrender.batch.dask_link import Seat
from scanrender.batch.dask_pool import DaskPool
from scanrender.batch.dask_worker import about, rest, sees, stop
from scanrender.batch.jobs import make_jobs, single_job
from scanrender.batch.tasks import PoolOptions, Task
from scanrender.errors import OutputError, UsageError

MADE_BY = {"scanrender": "1.0", "numpy": "2.0", "scanrender's code for prep": "abc"}


class Farm:
    """A link to workers that are not there; `told` overrides what they say of themselves."""

    address = "tcp://nowhere:1"

    def __init__(self, gpus: dict[str, int], told: dict[str, Any] | None = None, slots: int = 1):
        self.there = {a: Seat(a, f"id of {a}", a, slots, g, True) for a, g in gpus.items()}
        self.told, self.unseen = told or {}, dict[str, Any]()

    def seats(self) -> dict[str, Seat]:
        return dict(self.there)

    def ask(self, function: Any, *arguments: Any, workers: list[str], **_: Any) -> dict[str, Any]:
        if function is sees:
            return {address: self.unseen.get(address) for address in workers}
        if function in (stop, rest):
            return {}
        assert function is about
        own = {"free_mib": 1000, "made_by": MADE_BY}
        told = {a: {"host": f"host of {a}", "machine": a, **own} for a in workers}
        return {a: self.told.get(a, said) for a, said in told.items()}

    def ask_scheduler(self, function: Any) -> Any:
        return None

    def subscribe(self, topic: str, hear: Any) -> None:
        pass

    def unsubscribe(self, topic: str) -> None:
        pass


def crew_of(farm: Any, said: list[str] | None = None) -> Crew:
    crew = Crew(farm, MADE_BY, {}, (said if said is not None else []).append)
    crew.gather()
    return crew


def tasks(mib: int = 100) -> tuple[Task, Task]:
    """A preparation and a rendering."""
    job = single_job(Path("a.obj"), pipeline(), Path("out"))
    return Task(job, "prep", mib=mib), Task(job, mib=mib)


def names(crew: Crew, task: Task) -> list[str]:
    return [mate.address for mate in crew.free_for(task)]


def test_rendering_is_for_gpus_where_any_worker_has_one():
    prep, render = tasks()
    crew = crew_of(Farm({"gpu": 1, "cpu": 0}))
    assert names(crew, render) == ["gpu"]
    assert names(crew, prep) == ["cpu", "gpu"], "what can go elsewhere leaves the GPU free"
    assert sorted(names(crew_of(Farm({"a": 0, "b": 0})), render)) == ["a", "b"]


def test_a_gpu_renders_one_scan_at_a_time_and_prepares_beside_it():
    prep, render = tasks()
    crew = crew_of(Farm({"gpu": 1}, slots=3))
    crew.take(render, crew.mates["gpu"])
    assert names(crew, render) == []
    assert names(crew, prep) == ["gpu"]


def test_gpus_that_are_lost_are_waited_for():
    """Otherwise the rest of a turn would be of another driver, and slow, because of a moment."""
    _, render = tasks()
    farm = Farm({"gpu": 1, "cpu": 0})
    crew = crew_of(farm)
    del farm.there["gpu"]
    crew._next_look = 0.0
    assert [mate.address for mate in crew.look()] == ["gpu"]
    assert names(crew, render) == []


def test_but_not_for_ever():
    _, render = tasks()
    farm = Farm({"gpu": 1, "cpu": 0})
    crew, said = crew_of(farm), list[str]()
    del farm.there["gpu"]
    crew._next_look = 0.0
    ended: list[Task] = []
    link: Any = farm
    options = PoolOptions(0, timeout_s=0.1)
    DaskPool(link, crew, options, lambda *_: None, said.append, ended.append).run([render])
    assert said == ["no worker with a GPU is left at tcp://nowhere:1; waiting for one"]
    assert ended == [render]
    assert "has had no worker with a GPU for 0.1 s" in str(render.error)


def test_no_more_at_once_than_a_machine_holds():
    prep, render = tasks(mib=600)
    farm = Farm({"a": 0, "b": 0, "c": 0})
    one = {"host": "h", "machine": "h", "free_mib": 1000, "made_by": MADE_BY}
    farm.told = {"a": one, "b": one}
    crew = crew_of(farm)
    crew.take(prep, crew.mates["a"])
    assert not crew.fits(render, crew.mates["b"]), "it is the same machine"
    assert crew.fits(render, crew.mates["c"])
    assert crew.sharers(crew.mates["a"]) == 2
    assert crew.sharers(crew.mates["c"]) == 1


@pytest.mark.parametrize(
    ("told", "sentence"),
    [
        ({"numpy": "1.9"}, "numpy 1.9 instead of 2.0"),
        ({"scanrender": "0.9"}, "scanrender 0.9 instead of 1.0"),
        ({"scanrender's code for prep": "x"}, "scanrender's code for prep is another one"),
    ],
)
def test_another_installation_is_refused(told: dict[str, str], sentence: str):
    other = {"host": "farm07", "machine": "m", "free_mib": 1, "made_by": {**MADE_BY, **told}}
    with pytest.raises(UsageError, match="on farm07 is another installation") as caught:
        crew_of(Farm({"a": 0, "b": 0}, {"b": other}))
    assert sentence in caught.value.what


def test_a_worker_without_scanrender_is_refused():
    missing = ModuleNotFoundError("No module named 'scanrender'")
    with pytest.raises(UsageError, match="the Dask worker b cannot run this scanrender"):
        crew_of(Farm({"a": 0, "b": 0}, {"b": missing}))


def test_a_worker_that_hangs_is_refused_and_one_that_goes_is_not_missed():
    late = TimeoutError("no answer within 60 s")
    with pytest.raises(UsageError, match="the Dask worker b gives no answer within 60 s"):
        crew_of(Farm({"a": 0, "b": 0}, {"b": late}))
    crew = crew_of(Farm({"a": 0, "b": 0}, {"b": ConnectionResetError("gone")}))
    assert list(crew.mates) == ["a"]
    assert crew._refused == set()


def test_one_that_comes_later_and_will_not_do_is_left_out():
    said: list[str] = []
    farm = Farm({"a": 0})
    crew = crew_of(farm, said)
    farm.there["b"] = Seat("b", "id of b", "b", 1, 0, True)
    farm.unseen["b"] = ("/data/out", "is another folder")
    for _ in range(2):
        crew._next_look = 0.0
        assert crew.look() == []
    assert list(crew.mates) == ["a"]
    [line] = said
    assert "does not see /data/out: it is another folder; it gets no work" in line


def test_one_with_the_address_of_another_is_another():
    farm = Farm({"a": 0})
    crew = crew_of(farm)
    first = crew.mates["a"]
    farm.there["a"] = Seat("a", "another id", "a", 1, 0, True)
    crew._next_look = 0.0
    assert crew.look() == [first]
    assert crew.mates["a"].seat.id == "another id"


# --- what is seen --------------------------------------------------------------------------------


def test_what_differs_between_here_and_there(tmp_path: Path):
    scan, out = tmp_path / "a.obj", tmp_path / "out"
    scan.write_text("v 0 0 0\n" * 4000)
    ball = save_asset(sphere(20.0, (0.6, 0.3, 0.2), rings=6), tmp_path / "ball")
    jobs = make_jobs([scan, ball], pipeline(), "the test", out)
    with seen.evidence(jobs, out) as question:
        assert seen.unseen(question) is None
        assert seen.unseen({**question, "word": "another"}) == (str(out), "is another folder")
        assert seen.unseen({**question, "out": "/nowhere"}) == ("/nowhere", "is not there")
        scan.write_text("v 0 0 0\n" * 3999 + "v 0 0 1\n")
        assert seen.unseen(question) == (str(scan), "is another file")
        scan.unlink()
        assert seen.unseen(question) == (str(scan), "is not there or cannot be read")
    assert list(out.iterdir()) == [], "the evidence is gone"


def test_nothing_is_asked_where_nothing_can_be_written(tmp_path: Path):
    (tmp_path / "out").write_text("a file")
    with pytest.raises(OutputError), seen.evidence([], tmp_path / "out"):
        pass


def test_what_made_results_is_read_anew(monkeypatch: pytest.MonkeyPatch):
    """A Dask worker lives for weeks; what it was started with may have been replaced."""
    before = seen.made_by()
    assert seen.differences(before, seen.made_by()) == ""
    monkeypatch.setattr(seen.keys.metadata, "version", lambda name: "0")
    assert "numpy 0 instead of" in seen.differences(before, seen.made_by())
