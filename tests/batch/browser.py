"""A real browser, without a window: opens files, says what it asked of the network.

Where there is none (Debian: apt-get install chromium chromium-driver) its tests are skipped.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Browser = Any

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
DRIVER = shutil.which("chromedriver")
needs_browser = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="no chromium and chromedriver on this machine"
)


def started(profile: Path) -> Browser:
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for word in (
        "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
        "--disable-background-networking", "--disable-component-update", "--disable-sync",
        "--no-first-run", "--window-size=1280,1000",
        f"--user-data-dir={profile}",
    ):  # fmt: skip
        options.add_argument(word)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    return webdriver.Chrome(options=options, service=Service(str(DRIVER)))


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
    from selenium.common.exceptions import ElementClickInterceptedException

    def is_clicked() -> bool:
        # A page whose pictures are still coming moves between the look at where a card is and the
        # click there: as people do, try again.
        try:
            one(browser, f'a.open[aria-label="Open {label}"]').click()
        except ElementClickInterceptedException:
            return False
        return True

    wait(browser, is_clicked)
    wait(browser, lambda: all_of(browser, ".stage"))
    assert one(browser, "h1").text == label


def choose(browser: Browser, side: str, words: str, group: str | None = None) -> None:
    where = f'select[aria-label="{side}"] '
    if group is not None:
        where += f'optgroup[label="{group}"] '
    next(x for x in all_of(browser, f"{where}option") if x.text == words).click()


def number_of(element: Any) -> list[float]:
    return [float(word) for word in element.get_attribute("data-values").split()]
