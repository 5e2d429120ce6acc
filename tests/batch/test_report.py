"""The morning report, made by runs in processes of their own and looked at in a real browser.

The browser opens the file, with no server and no network. Where there is none (Debian: apt-get
install chromium chromium-driver) those tests are skipped; what the page is given is tested anyway.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from render.synthetic import sphere

from scanrender.asset import save_asset
from scanrender.outputs.exr import read_exr

PIPELINE = """
version: 1
camera: {width_px: 48, height_px: 60}
turntable: {frames: 5}
quality: {supersampling: 1}
lights: [{type: directional, shadow_px: 64}]
outputs: {buffers: [depth_mm, normal_shading, display], contact_frames: 2}
matrix:
  look: {natural: {}, oily: {extends: skin/oily}}
"""
BROKEN = "<img src=x onerror=alert(1)>"  # the stem of a scan's name, which a page must not believe

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
DRIVER = shutil.which("chromedriver")
needs_browser = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="no chromium and chromedriver on this machine"
)
pytestmark = pytest.mark.gl


def run(folder: Path, *arguments: str, code: str = "") -> subprocess.CompletedProcess[str]:
    start = f"{code}\nfrom scanrender.cli.main import main\nmain()\n"
    return subprocess.run(
        [sys.executable, "-c", start, *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "NO_COLOR": "1"},
        timeout=300,
        check=False,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
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


@pytest.fixture(scope="module")
def page(folder: Path) -> Path:
    return folder / "out" / "report.html"


def told(page: Path) -> dict[str, Any]:
    """The data of a page, as its scripts read it."""
    return held(page, "data")


def held(page: Path, name: str) -> dict[str, Any]:
    text = page.read_text(encoding="utf-8")
    found = re.search(rf'<script type="application/json" id="{name}">(.*?)</script>', text)
    assert found is not None
    data = json.loads(found[1])
    assert isinstance(data, dict)
    return data


# --- what the page is given ----------------------------------------------------------------------


def test_failures_come_first_with_what_to_do(page: Path):
    jobs = told(page)["jobs"]
    assert [job["status"] for job in jobs] == ["failed"] * 2 + ["done"] * 4
    for job in jobs[:2]:
        assert job["error"]["exit_code"] == 4
        assert job["error"]["what"]
        assert job["error"]["fix"]
    assert jobs[2]["lost"]["symmetric_mm"]["p99"] == 0.072
    assert {"render", "write"} <= set(jobs[2]["seconds"])


def test_the_page_names_nothing_of_the_network(page: Path):
    text = page.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
    assert not re.search(r"https?://|@import|<link[^>]+stylesheet", text)


def test_downloads_are_there(page: Path):
    from urllib.parse import unquote

    files = [file for job in told(page)["jobs"] for file in job["downloads"]]
    assert {"turntable.mp4", "contact_sheet.png", "manifest.json", "frame_0000.exr"} <= {
        file["name"] for file in files
    }
    for file in files:
        if not file["href"].startswith("file:"):
            assert (page.parent / unquote(file["href"])).stat().st_size == file["bytes"]


def test_it_is_made_again_from_the_folder_alone(folder: Path, page: Path, tmp_path: Path):
    moved = tmp_path / "moved"
    shutil.copytree(folder / "out", moved)
    (moved / "report.html").unlink()
    loads = "import sys, atexit; atexit.register(lambda: print('moderngl' in sys.modules))"
    again = run(tmp_path, "report", "moved", code=loads)
    assert again.returncode == 0, again.stderr
    assert again.stdout.split() == ["moved/report.html", "False"]
    new, old = told(moved / "report.html"), told(page)
    assert {**new, "title": old["title"]} == old


def test_a_picture_is_read_again_only_when_it_changed(folder: Path, tmp_path: Path):
    moved = tmp_path / "moved"
    shutil.copytree(folder / "out", moved)
    before = {path.name: path.stat().st_mtime_ns for path in (moved / ".report").iterdir()}
    assert len(before) == 4
    video = moved / "anna" / "oily" / "turntable.mp4"
    video.write_bytes(b"damaged")
    assert run(tmp_path, "report", "moved").returncode == 0
    after = {path.name: path.stat().st_mtime_ns for path in (moved / ".report").iterdir()}
    assert len(after) == 4
    assert len(set(before.items()) & set(after.items())) == 3
    jobs = {job["label"]: job["id"] for job in told(moved / "report.html")["jobs"]}
    pixels = held(moved / "report.html", f"pixels-{jobs['anna oily']}")
    assert "cannot read video" in pixels["unread"][0]
    assert pixels["page"], "the contact sheet stands in"


def test_a_folder_that_nothing_ran_in_is_told(tmp_path: Path):
    (tmp_path / "empty").mkdir()
    done = run(tmp_path, "report", "empty")
    assert done.returncode == 3
    assert "does not tell what was done" in done.stderr
    assert not (tmp_path / "empty" / "report.html").exists()


def test_a_run_with_nothing_to_do_leaves_the_page_alone(folder: Path, tmp_path: Path):
    words = ("run", "p.yaml", "anna", "--set", "matrix={}", "--out", str(tmp_path / "one"))
    words = (*words, "--progress", "none")
    assert run(folder, *words).returncode == 0
    page = tmp_path / "one" / "report.html"
    assert [job["label"] for job in told(page)["jobs"]] == ["anna"]
    made = page.stat().st_mtime_ns
    again = run(folder, *words)
    assert again.returncode == 0
    assert "report:" not in again.stderr
    assert page.stat().st_mtime_ns == made


def test_one_scan_that_failed_has_a_page(folder: Path, tmp_path: Path):
    out = tmp_path / "out"
    scan = f"{BROKEN}.ply"
    done = run(folder, "run", "turntable", scan, "--out", str(out), "--progress", "none")
    assert done.returncode == 4
    assert told(out / "report.html")["jobs"][0]["status"] == "failed"


# --- the page in a browser -----------------------------------------------------------------------


Browser = Any


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for word in (
        "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
        "--disable-background-networking", "--disable-component-update", "--disable-sync",
        "--no-first-run", "--window-size=1280,1000",
        f"--user-data-dir={tmp_path_factory.mktemp('browser')}",
    ):  # fmt: skip
        options.add_argument(word)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(str(DRIVER)))
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


def requests(browser: Browser) -> list[str]:
    said = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    sent = [entry for entry in said if entry["method"] == "Network.requestWillBeSent"]
    return [entry["params"]["request"]["url"] for entry in sent]


def open_page(browser: Browser, page: Path) -> None:
    browser.get("about:blank")  # another fragment alone would not load the file anew
    browser.get(page.as_uri())


def emulate(browser: Browser, scheme: str) -> None:
    feature = {"name": "prefers-color-scheme", "value": scheme}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})


def wait(browser: Browser, found: Callable[[], Any]) -> Any:
    from selenium.webdriver.support.ui import WebDriverWait

    return WebDriverWait(browser, 20).until(lambda _: found())


def all_of(browser: Browser, selector: str) -> list[Any]:
    return list(browser.find_elements("css selector", selector))


def one(browser: Browser, selector: str) -> Any:
    return wait(browser, lambda: all_of(browser, selector))[0]


def open_scan(browser: Browser, label: str) -> None:
    one(browser, f'a.open[aria-label="Open {label}"]').click()
    wait(browser, lambda: all_of(browser, ".stage"))
    assert one(browser, "h1").text == label


def choose(browser: Browser, side: str, words: str, group: str | None = None) -> None:
    where = f'select[aria-label="{side}"] '
    if group is not None:
        where += f'optgroup[label="{group}"] '
    next(x for x in all_of(browser, f"{where}option") if x.text == words).click()


def number_of(element: Any) -> list[float]:
    return [float(word) for word in element.get_attribute("data-values").split()]


@needs_browser
def test_it_opens_with_what_failed(opened: Browser):
    assert opened.title.startswith("2 failed")
    first = one(opened, "main section")
    assert first.get_attribute("aria-label") == "failures"
    failure = all_of(opened, ".failure")
    assert len(failure) == 1, "two looks of one scan failed for one reason"
    assert BROKEN in failure[0].text
    assert "to do" in failure[0].text
    assert len(all_of(opened, ".cards > li")) == 4
    assert not all_of(opened, "img[src=x]"), "a name became an element"


@needs_browser
def test_a_turn_follows_the_mouse_and_the_keys(opened: Browser):
    from selenium.webdriver import ActionChains, Keys

    turn = one(opened, '.turn[role="slider"]')
    strip = turn.find_element("css selector", ".strip")
    assert turn.get_attribute("aria-valuetext") == "0°, frame 0"
    before = strip.value_of_css_property("background-position")
    width = turn.size["width"]
    ActionChains(opened).move_to_element_with_offset(turn, round(width * 0.4), 0).perform()
    assert turn.get_attribute("aria-valuetext") == "288°, frame 4"
    assert strip.value_of_css_property("background-position") != before
    turn.send_keys(Keys.ARROW_RIGHT)
    assert turn.get_attribute("aria-valuenow") == "0", "a turn is closed"
    turn.send_keys(Keys.ARROW_LEFT, Keys.ARROW_LEFT)
    assert turn.get_attribute("aria-valuenow") == "3"
    assert "data:image/webp" in strip.value_of_css_property("background-image")


@needs_browser
def test_the_value_under_the_pointer_is_that_of_the_exr(opened: Browser, folder: Path):
    from selenium.webdriver import ActionChains

    open_scan(opened, "anna natural")
    choose(opened, "A", "depth_mm")
    stage = one(opened, ".stage")
    ActionChains(opened).move_to_element_with_offset(stage, 30, -20).perform()
    shown = wait(opened, lambda: all_of(opened, ".readout [data-values]"))[0]
    x, y = map(int, re.findall(r"\d+", one(opened, ".readout > .soft").text)[:2])
    layers = read_exr(folder / "out/anna/natural/buffers/frame_0000.exr")
    depth = float(layers["depth_mm"][y, x, 0])
    span = float(np.ptp(layers["depth_mm"]))
    assert number_of(shown)[0] == pytest.approx(depth, abs=span / 65533)
    assert "mm" in shown.text
    legend = one(opened, ".legend").text
    assert "depth_mm" in legend
    assert "mm · " in legend


@needs_browser
def test_two_buffers_are_slid_over_each_other(opened: Browser):
    from selenium.webdriver import ActionChains, Keys

    open_scan(opened, "anna natural")
    slider = one(opened, 'input[type="range"]')
    assert not slider.is_enabled(), "there is nothing to slide over"
    choose(opened, "A", "display")
    choose(opened, "B", "normal_shading", "this scan")
    side = one(opened, '[data-side="b"]')
    wait(opened, lambda: side.is_displayed() and slider.is_enabled())
    assert side.value_of_css_property("clip-path") == "inset(0px 0px 0px 50%)"
    slider.send_keys(Keys.HOME)
    assert side.value_of_css_property("clip-path") in ("inset(0px)", "inset(0px 0px 0px 0%)")
    slider.send_keys(Keys.END)
    assert side.value_of_css_property("clip-path") == "inset(0px 0px 0px 100%)"
    grip = one(opened, ".grip")
    opened.execute_script("arguments[0].scrollIntoView({block: 'center'})", grip)
    width = one(opened, ".stage").size["width"]
    ActionChains(opened).move_to_element_with_offset(grip, -5, 0).click_and_hold().move_by_offset(
        -round(width / 2), 0
    ).release().perform()
    assert 40 < float(slider.get_attribute("value")) < 60


@needs_browser
def test_a_look_is_compared_with_another(opened: Browser):
    open_scan(opened, "anna natural")
    choose(opened, "A", "display")
    choose(opened, "B", "the same as A", "anna oily")
    image = one(opened, '[data-side="b"] img')
    wait(opened, lambda: image.get_attribute("alt") == "display of anna oily")
    wait(opened, lambda: opened.execute_script("return arguments[0].naturalWidth", image) == 48)
    assert image.get_attribute("src") != one(opened, '[data-side="a"] img').get_attribute("src")


@needs_browser
def test_the_viewer_is_worked_by_keys(opened: Browser):
    from selenium.webdriver import Keys

    open_scan(opened, "anna natural")
    stage, tag = one(opened, ".stage"), one(opened, ".tag")
    first = tag.text
    stage.send_keys("n")
    assert tag.text != first
    stage.send_keys("p")
    assert tag.text == first
    image = one(opened, '[data-side="a"] img')
    before = image.get_attribute("style")
    stage.send_keys("++")
    assert "scale(2.25)" in image.get_attribute("style")
    near = image.get_attribute("style")
    stage.send_keys(Keys.SHIFT, Keys.ARROW_RIGHT)
    assert image.get_attribute("style") != near
    stage.send_keys("0")
    assert image.get_attribute("style") == before
    stage.send_keys(Keys.ARROW_RIGHT)
    wait(opened, lambda: all_of(opened, ".readout [data-values]"))
    place = one(opened, ".readout > .soft")
    assert place.text.startswith("pixel 25, 30")
    stage.send_keys(Keys.ARROW_DOWN)
    wait(opened, lambda: place.text.startswith("pixel 25, 31"))


@needs_browser
def test_everything_is_reached_by_tab_with_a_visible_focus(opened: Browser):
    from selenium.webdriver import ActionChains, Keys

    reached = []
    for _ in range(14):
        ActionChains(opened).send_keys(Keys.TAB).perform()
        now = opened.switch_to.active_element
        reached.append((now.tag_name, now.get_attribute("role")))
        assert now.value_of_css_property("outline-style") == "solid"
    assert ("div", "slider") in reached
    assert reached.count(("a", None)) >= 4


@needs_browser
@pytest.mark.parametrize("label", [None, "bert oily"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_scrolls_one_way_only(opened: Browser, label: str | None, scheme: str):
    emulate(opened, scheme)
    screen = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    opened.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    if label is not None:
        open_scan(opened, label)
    assert opened.execute_script("return document.documentElement.scrollWidth") <= 390
    small = opened.execute_script(
        "return [...document.querySelectorAll('main *')].filter((e) => e.innerText &&"
        " parseFloat(getComputedStyle(e).fontSize) < 11).length"
    )
    assert small == 0


def contrast(one: str, other: str) -> float:
    """WCAG 2.1 contrast ratio of two `rgb(…)` colours."""

    def luminance(words: str) -> float:
        rgb = np.array([float(word) for word in re.findall(r"[\d.]+", words)[:3]]) / 255.0
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@needs_browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_is_readable_by_day_and_by_night(opened: Browser, scheme: str):
    emulate(opened, scheme)
    found = opened.execute_script("""
        const ground = (e) => {
          for (; e; e = e.parentElement) {
            const colour = getComputedStyle(e).backgroundColor;
            if (!/, 0\\)|transparent/.test(colour)) return colour;
          }
        };
        return [...document.querySelectorAll("h1, h2, h3, p, dt, dd, a, .badge, footer")]
          .filter((e) => e.innerText && e.offsetParent)
          .map((e) => [e.innerText, getComputedStyle(e).color, ground(e)]);""")
    assert len(found) > 20
    weak = [(text, c) for text, ink, ground in found if (c := contrast(ink, ground)) < 4.5]
    assert not weak
    grounds = {"light": 200, "dark": 40}
    red = float(
        re.findall(r"\d+", one(opened, "body").value_of_css_property("background-color"))[0]
    )
    assert (red > grounds["light"]) == (scheme == "light")


@needs_browser
def test_settings_show_what_differs(opened: Browser):
    open_scan(opened, "anna natural")
    table = one(opened, '[aria-label="settings"] tbody')
    differing = table.text
    assert "camera.width_px 48 " in differing
    assert "diffusion.method" not in differing
    one(opened, '[aria-label="settings"] input').click()
    assert "diffusion.method" in table.text
    opened.back()
    wait(opened, lambda: all_of(opened, ".cards"))


@needs_browser
def test_pixels_beside_the_page_are_found_too(
    browser: Browser, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    from scanrender.batch import report

    moved = tmp_path / "moved #1"
    shutil.copytree(folder / "out", moved)
    monkeypatch.setattr(report, "EMBEDDED_BYTES", 0)
    page = report.write_report(moved)
    assert 'id="pixels-' not in page.read_text(encoding="utf-8")
    open_page(browser, page)
    open_scan(browser, "anna natural")
    choose(browser, "A", "depth_mm")
    one(browser, ".stage").send_keys("+")
    shutil.rmtree(moved / ".report")
    open_page(browser, page)
    assert "is not beside this page" in wait(
        browser, lambda: [x for x in all_of(browser, ".turn .none") if x.text]
    )[0].text  # fmt: skip
    browser.get_log("browser")
