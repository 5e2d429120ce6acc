"""The morning report, looked at in a real browser: from the file, with no server, no network."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from batch.browser import (
    Browser,
    all_of,
    choose,
    emulate,
    needs_browser,
    number_of,
    one,
    open_page,
    open_scan,
    wait,
)
from batch.night import BROKEN

from scanrender.outputs.exr import read_exr

pytestmark = [pytest.mark.gl, needs_browser]


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


def test_the_value_under_the_pointer_is_that_of_the_exr(opened: Browser, night: Path):
    from selenium.webdriver import ActionChains

    open_scan(opened, "anna natural")
    choose(opened, "A", "depth_mm")
    stage = one(opened, ".stage")
    ActionChains(opened).move_to_element_with_offset(stage, 30, -20).perform()
    shown = wait(opened, lambda: all_of(opened, ".readout [data-values]"))[0]
    x, y = map(int, re.findall(r"\d+", one(opened, ".readout > .soft").text)[:2])
    layers = read_exr(night / "out/anna/natural/buffers/frame_0000.exr")
    depth = float(layers["depth_mm"][y, x, 0])
    span = float(np.ptp(layers["depth_mm"]))
    assert number_of(shown)[0] == pytest.approx(depth, abs=span / 65533)
    assert "mm" in shown.text
    legend = one(opened, ".legend").text
    assert "depth_mm" in legend
    assert "mm · " in legend


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


def test_a_look_is_compared_with_another(opened: Browser):
    open_scan(opened, "anna natural")
    choose(opened, "A", "display")
    choose(opened, "B", "the same as A", "anna oily")
    image = one(opened, '[data-side="b"] img')
    wait(opened, lambda: image.get_attribute("alt") == "display of anna oily")
    wait(opened, lambda: opened.execute_script("return arguments[0].naturalWidth", image) == 48)
    assert image.get_attribute("src") != one(opened, '[data-side="a"] img').get_attribute("src")


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


def test_pixels_beside_the_page_are_found_too(
    browser: Browser, night: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    from scanrender.batch import report

    moved = tmp_path / "moved #1"
    shutil.copytree(night / "out", moved)
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
