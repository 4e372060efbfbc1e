"""The page in a real browser, with the keyboard alone, at the width of a desktop and of a phone."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from web.small_site import FRAMES, Running, running, workspace

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
webdriver = pytest.importorskip("selenium.webdriver", reason="the package selenium is not installed")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (CHROMIUM and DRIVER), reason="chromium and chromedriver are not installed"),
]
KEYS = {
    "Tab": ("Tab", 9),
    "Enter": ("Enter", 13),
    "ArrowRight": ("ArrowRight", 39),
    "ArrowLeft": ("ArrowLeft", 37),
}
PATIENCE_S = 40.0  # pictures are computed on a busy machine
MOST_TABS = 60


class Browser:
    """A browser that is used by keys alone."""

    def __init__(self, width: int, height: int, *, is_phone: bool) -> None:
        options = webdriver.ChromeOptions()
        options.binary_location = CHROMIUM
        for argument in ("headless=new", "no-sandbox", "disable-gpu", f"window-size={width},{height}"):
            options.add_argument(f"--{argument}")
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        if is_phone:
            metrics = {"width": width, "height": height, "pixelRatio": 2.0, "touch": True}
            options.add_experimental_option("mobileEmulation", {"deviceMetrics": metrics})
        self.driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))

    def press(self, key: str) -> None:
        """Press a key, as a keyboard would: the page sees no click."""
        name, code = KEYS[key]
        event = {"key": name, "code": name, "windowsVirtualKeyCode": code}
        if key == "Enter":
            event["text"] = "\r"
        for kind in ("keyDown", "keyUp"):
            self.driver.execute_cdp_cmd("Input.dispatchKeyEvent", {"type": kind, **event})

    def type(self, text: str) -> None:
        self.driver.execute_cdp_cmd("Input.insertText", {"text": text})

    def ask(self, script: str) -> object:
        return self.driver.execute_script(f"return {script}")

    def tab_to(self, condition: str) -> None:
        """Press Tab until the focused element fulfils a condition on `e`; it must show that it has the focus."""
        for _ in range(MOST_TABS):
            self.press("Tab")
            if self.ask(f"((e) => Boolean({condition}))(document.activeElement)"):
                assert self.ask("getComputedStyle(document.activeElement).outlineStyle") != "none"
                return
        pytest.fail(f"no element that Tab reaches fulfils {condition}")

    def wait(self, condition: Callable[[], object], what: str) -> None:
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, (
                f"waited in vain for {what}; the page says: {self.ask('document.body.innerText')}"
            )
            time.sleep(0.1)

    def wait_for(self, script: str) -> None:
        self.wait(lambda: self.ask(f"document.readyState === 'complete' && Boolean({script})"), script)

    def addresses(self) -> set[str]:
        """Hosts of all requests of the page since it was asked last."""
        events = [json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance")]
        urls = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
        return {urlsplit(url).netloc for url in urls if url.startswith("http")}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with running(workspace(tmp_path_factory.mktemp("browsed"))) as found:
        yield found


@pytest.fixture(params=[(1280, 900, False), (390, 844, True)], ids=["desktop", "phone"])
def browser(request: pytest.FixtureRequest) -> Iterator[Browser]:
    width, height, is_phone = request.param
    opened = Browser(width, height, is_phone=is_phone)
    yield opened
    opened.driver.quit()


def fits(browser: Browser) -> bool:
    """Whether no part of the page is wider than the window."""
    return bool(browser.ask("document.documentElement.scrollWidth <= window.innerWidth"))


def test_search_hit_frame_and_back_by_keyboard(server: Running, browser: Browser) -> None:
    browser.driver.get(server.address)
    assert fits(browser)
    browser.tab_to("e.id === 'q'")
    browser.type("bus")
    browser.press("Enter")
    browser.wait_for("document.querySelector('.card')")
    assert "hits for “bus”" in str(browser.ask("document.getElementById('count').innerText"))
    assert fits(browser)
    browser.wait_for(
        "[...document.querySelectorAll('.card img')].slice(0, 2).every((i) => i.naturalWidth > 0)"
    )

    browser.tab_to("e.matches('.card h3 a') && e.href.includes('street-0')")
    browser.press("Enter")
    browser.wait_for("document.getElementById('scene') && document.getElementById('scene').dataset.shown")
    assert browser.ask("document.querySelector('h1').innerText") == "bus"
    assert fits(browser)
    before = int(str(browser.ask("document.getElementById('scene').dataset.shown")))

    browser.tab_to("e.id === 'scene'")
    drawn = browser.ask("document.getElementById('scene').toDataURL()")
    browser.press("ArrowLeft")
    assert browser.ask("document.getElementById('scene').toDataURL()") != drawn  # it has turned

    browser.tab_to("e.id === 'at'")
    step = "ArrowRight" if before < FRAMES[-1] else "ArrowLeft"
    browser.press(step)
    after = before + (1 if step == "ArrowRight" else -1)
    browser.wait_for(f"document.getElementById('scene').dataset.shown === '{after}'")
    assert browser.ask("document.getElementById('frame-name').innerText") == str(after)
    browser.wait_for(f"document.querySelector('#cameras img').src.includes('/street-0/{after}/0')")
    browser.wait_for("document.querySelector('#cameras img').naturalWidth > 0")

    browser.driver.execute_script("document.activeElement.blur(); window.scrollTo(0, 0)")
    browser.driver.execute_script("document.getElementById('main').focus()")
    browser.tab_to("e.innerText.includes('Back to the results')")
    browser.press("Enter")
    browser.wait_for("document.querySelector('.card')")
    assert browser.ask("document.getElementById('q').value") == "bus"

    assert browser.addresses() == {f"127.0.0.1:{server.port}"}
    assert browser.driver.get_log("browser") == []


def test_the_threshold_by_keyboard(server: Running, browser: Browser) -> None:
    browser.driver.get(f"{server.address}/?q=bus,car&threshold=0")
    count = "document.getElementById('count').innerText"
    assert str(browser.ask(count)).startswith("4 hits")
    browser.tab_to("e.id === 'threshold'")
    for _ in range(30):
        browser.press("ArrowRight")
    assert browser.ask("document.getElementById('threshold-value').innerText") == "0.30"
    faded = int(str(browser.ask("document.querySelectorAll('.bar.faded').length")))
    assert faded == 6  # of twenty
    browser.press("Enter")
    browser.wait_for("location.search.includes('threshold=0.3')")
    browser.wait_for("document.getElementById('count')")
    assert str(browser.ask(count)).startswith("3 hits")
    assert browser.driver.get_log("browser") == []


def test_every_field_has_a_label_and_every_picture_a_text(server: Running, browser: Browser) -> None:
    for path in ("/", "/?q=bus&max_speed=90", "/hit/labels/street-0/0/0"):
        browser.driver.get(server.address + path)
        unlabelled = browser.ask(
            "[...document.querySelectorAll('input:not([type=hidden]), select')]"
            ".filter((e) => !e.labels.length || !e.labels[0].textContent.trim()).map((e) => e.name)"
        )
        assert unlabelled == [], path
        assert browser.ask("[...document.images].filter((e) => !e.alt).length") == 0, path
        assert browser.ask("document.querySelectorAll('main, h1, header, footer').length") == 4, path
        assert fits(browser), path


def test_it_works_without_javascript(server: Running, browser: Browser) -> None:
    browser.driver.execute_cdp_cmd("Emulation.setScriptExecutionDisabled", {"value": True})
    browser.driver.get(f"{server.address}/hit/labels/street-0/0/0?at=2")
    text = browser.driver.page_source
    assert 'id="frame-name">2<' in text
    assert "/above/labels/street-0/0/0" in text
    assert "Frame after" in text


def test_the_pages_of_the_tests_are_there(tmp_path: Path) -> None:
    """The styles and scripts ship in the package."""
    from upvl_cli.web.site import STATIC

    assert set(STATIC) == {"style.css", "page.js", "view3d.js", "icon.svg"}
