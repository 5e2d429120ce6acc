"""A finished job; a night that two of three scans survived, its report, a browser to open it in."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from batch.browser import Browser, emulate, open_page, requests, started
from batch.jobs import Counted, silent, tiny, write_ball
from batch.night import BROKEN, PIPELINE, run
from render.synthetic import sphere

from scanrender.asset import save_asset
from scanrender.batch.job import run_job


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counted:
    return Counted(monkeypatch)


@pytest.fixture(scope="session")
def asset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("asset") / "ball"
    return save_asset(sphere(20.0, (0.6, 0.3, 0.2), rings=10), folder)


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A raw scan, `ball.obj`, and `out`, its finished job; copied by those that change it."""
    folder = tmp_path_factory.mktemp("finished")
    run_job(write_ball(folder / "ball.obj"), tiny(), folder / "out", silent)
    return folder


@pytest.fixture
def work(finished: Path, tmp_path: Path) -> Path:
    shutil.copytree(finished, tmp_path / "w")  # with its times; the inodes are others
    return tmp_path / "w"


@pytest.fixture(scope="session")
def night(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two heads in two looks, one scan that is none: 4 of 6 complete."""
    folder = tmp_path_factory.mktemp("night")
    (folder / "p.yaml").write_text(PIPELINE)
    for name, warnings in (("anna", ()), ("bert", ("its units were guessed",))):
        asset = save_asset(sphere(20.0, (0.6, 0.3, 0.2), rings=10), folder / name)
        info = json.loads((asset / "asset.json").read_text())
        distance = {"mean": 0.021, "p99": 0.072, "max": 0.17}
        lost = {"charts": 37, "atlas_use": 0.7, "symmetric_mm": distance}
        lost |= {"prepared_to_raw_mm": distance, "raw_to_prepared_mm": distance}
        info |= {"lost": lost, "warnings": list(warnings)}
        (asset / "asset.json").write_text(json.dumps(info))
    (folder / f"{BROKEN}.ply").write_text("ply\nformat ascii 1.0\nelement vertex 3\n")
    done = run(
        folder, "run", "p.yaml", "anna", "bert", f"{BROKEN}.ply", "--out", "out",
        "--progress", "none",
    )  # fmt: skip
    assert done.returncode == 8, done.stderr
    assert "report: out/report.html" in done.stderr
    return folder


@pytest.fixture(scope="session")
def page(night: Path) -> Path:
    return night / "out" / "report.html"


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    driver = started(tmp_path_factory.mktemp("browser"))
    yield driver
    driver.quit()


@pytest.fixture
def opened(browser: Browser, page: Path) -> Iterator[Browser]:
    """The batch's page, from the file system; afterwards nothing was said on the console, nothing
    was asked of the network."""
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    emulate(browser, "light")
    browser.get("about:blank")
    requests(browser)  # forget those of its own start page
    open_page(browser, page)
    yield browser
    assert [entry["message"] for entry in browser.get_log("browser")] == []
    assert {url.split(":")[0] for url in requests(browser)} <= {"file", "data", "blob"}
