"""The page in a real browser without network: at the width of a phone and of a desk, light and dark."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from report.made_up_run import made_up_run
from upvl_cli.report.run import write_report

BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
pytestmark = pytest.mark.skipif(
    not BROWSER or not DRIVER, reason="chromium and chromedriver are not installed"
)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator:
    """A browser that shows the report of the made-up run."""
    webdriver = pytest.importorskip("selenium.webdriver")
    from selenium.webdriver.chrome.service import Service

    workspace = made_up_run(tmp_path_factory.mktemp("run"), with_points=True)
    path = write_report(workspace, (), workspace.out / "report.html").path
    options = webdriver.ChromeOptions()
    for flag in ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"):
        options.add_argument(flag)
    options.binary_location = str(BROWSER)
    driver = webdriver.Chrome(options, Service(str(DRIVER)))
    driver.execute_cdp_cmd("Network.enable", {})
    driver.execute_cdp_cmd(
        "Network.emulateNetworkConditions",
        {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0},
    )
    yield driver, path
    driver.quit()


def show(browser: tuple, width_px: int, scheme: str):  # noqa: ANN202
    driver, path = browser
    metrics = {"width": width_px, "height": 800, "deviceScaleFactor": 1, "mobile": width_px < 600}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    driver.get(Path(path).as_uri())
    return driver


@pytest.mark.parametrize("width_px", [320, 390, 1280])
def test_page_is_no_wider_than_the_screen_and_shows_its_pictures(browser: tuple, width_px: int) -> None:
    driver = show(browser, width_px, "light")
    assert driver.execute_script("return document.documentElement.scrollWidth") == width_px
    widths = driver.execute_script("return [...document.images].map(image => image.naturalWidth)")
    assert len(widths) >= 4 and min(widths) > 0
    assert driver.execute_script("return performance.getEntriesByType('resource').length") <= len(widths)
    assert driver.execute_script(
        "return performance.getEntriesByType('resource').every(entry => entry.name.startsWith('data:'))"
    )


def test_page_follows_the_mode_of_the_reader(browser: tuple) -> None:
    colour = "return getComputedStyle(document.body).backgroundColor"
    light = show(browser, 390, "light").execute_script(colour)
    dark = show(browser, 390, "dark").execute_script(colour)
    assert (light, dark) == ("rgb(246, 247, 249)", "rgb(18, 20, 24)")


def contrast(first: str, second: str) -> float:
    """The ratio of WCAG 2 between two colours as a browser names them: rgb(1, 2, 3)."""

    def luminance(colour: str) -> float:
        parts = [int(part) / 255 for part in colour[4:-1].split(",")]
        linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    high, low = sorted((luminance(first), luminance(second)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_stand_out_from_their_background(browser: tuple, scheme: str) -> None:
    driver = show(browser, 1280, scheme)
    card = driver.execute_script("return getComputedStyle(document.querySelector('section')).backgroundColor")
    for selector in ("p", ".quiet", ".missing", "td", "a", ".level-ok"):
        element = f"document.querySelector('section {selector}')"
        if driver.execute_script(f"return {element} !== null"):
            colour = driver.execute_script(f"return getComputedStyle({element}).color")
            assert contrast(colour, card) >= 4.5, selector
