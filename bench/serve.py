"""How fast the web page answers: python bench/serve.py [--objects N] [--users N] [--seconds N] [--browser].

A made-up store of objects, each with the feature of some phrase, is served by `upvl serve` on a free port of this
machine. First one client asks new questions, one after the other; then many clients at once ask, look at hits, pictures
and scenes, and save, for a bounded time. Any answer but 200 is an error. With --browser a real browser searches, opens
a hit and moves the frame. The time of a search is also given as a multiple of one plain product of all mean features
with the words, in float32, which no exact search can do without. A bar is met by the processor time of the server: on a
machine that others use as well the clock measures them.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from html import unescape
from pathlib import Path
from statistics import median

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command has it
import httpx
import numpy as np

from machine import Stolen
from query_speed import BOXES, FRAMES, _workspace
from upvl_cli.perception.visual.open_vocabulary import COMPONENTS

BARS_S = {100_000: 0.3, 1_000_000: 1.5}
POINTS = 20  # of a box
WORDS = (
    "fire truck", "bus", "car", "pedestrian", "cyclist", "tree", "road", "traffic sign", "building", "truck", "van",
    "motorcycle", "trailer", "bench", "fence", "pole", "child", "taxi", "police car", "ambulance", "stroller", "dog",
    "wheelchair", "excavator", "tram", "skateboard", "barrier", "traffic cone", "hedge", "wall",
)  # fmt: skip
FILTERS = (
    "",
    "&motion=moving",
    "&max_range=30",
    "&min_speed=5",
    "&from=3&to=9",
    "&min_score=0.8",
    "&candidates=200",
)


def main() -> None:
    """Run and print; exits 1 where a bar is missed."""
    options = _options()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.store or Path(scratch)
        if not (folder / "out" / "pool-features").is_dir():
            _workspace(folder, options.objects // (BOXES * FRAMES), POINTS)
        started = time.perf_counter()
        with serving(folder) as (address, server):
            print(
                f"{options.objects:,} objects: ready in {time.perf_counter() - started:.1f} s, index included"
            )
            met = [_searches(address, server, options.objects)]
            if options.users:
                met.append(asyncio.run(_many(address, options.users, options.seconds)))
            if options.browser:
                met.append(_browser(address))
    sys.exit(not all(met))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument("--store", type=Path, help="keep the made-up store in this folder, and use it again")
    parser.add_argument("--objects", type=int, default=100_000)
    parser.add_argument("--users", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--browser", action="store_true")
    return parser.parse_args()


@contextmanager
def serving(folder: Path) -> Iterator[tuple[str, int]]:
    """Serve a workspace; yields its address and the number of its process."""
    upvl = Path(sys.executable).with_name("upvl")
    process = subprocess.Popen([upvl, "serve", "--port", "0"], cwd=folder, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:\d+", line)
        assert found, line
        yield found[0], process.pid
        peak_kb = re.search(r"VmHWM:\s+(\d+)", Path(f"/proc/{process.pid}/status").read_text())
        print(
            f"peak memory of the server, mapped files included: {int(peak_kb[1]) / 1024:.0f} MiB"
            if peak_kb
            else ""
        )
    finally:
        process.terminate()
        process.wait(20)


def _searches(address: str, server: int, objects: int) -> bool:
    """Ask new questions one after the other; the median and the slowest decide."""
    stolen = Stolen()
    with httpx.Client(base_url=address, timeout=60) as client:
        taken, before_s = [], _processor_s(server)
        for word in WORDS:
            started = time.perf_counter()
            answer = client.get("/", params={"q": word, "anyway": "1"})
            taken.append(time.perf_counter() - started)
            assert answer.status_code == 200, answer.text
            assert "hit" in answer.text
        processor_s = (_processor_s(server) - before_s) / len(WORDS)
        started = time.perf_counter()
        client.get("/", params={"q": WORDS[0], "anyway": "1", "threshold": "0.5"})
        again = time.perf_counter() - started
    features = np.ones((objects, COMPONENTS), dtype=np.float32)
    words = np.ones((COMPONENTS, 45), dtype=np.float32)
    started = time.perf_counter()
    features @ words
    plain = time.perf_counter() - started
    bar = BARS_S.get(objects, np.inf)
    print(
        f"{objects:,} objects: a new question {processor_s:.2f} s of a processor (bar {bar:g} s), "
        f"{median(taken):.2f} s by the clock (median of {len(taken)}; slowest "
        f"{max(taken):.2f} s), {median(taken) / plain:.1f} times a plain product; the same with another "
        f"threshold {again * 1000:.0f} ms; {stolen}"
    )
    return processor_s <= bar


def _processor_s(process: int) -> float:
    """Return the processor time that a process has used."""
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def _many(address: str, users: int, seconds: float) -> bool:
    """Let many clients use the page at once until the time is over."""
    counts: Counter[str] = Counter()
    times: dict[str, list[float]] = {}
    end = time.monotonic() + seconds

    async def get(client: httpx.AsyncClient, path: str) -> httpx.Response | None:
        started, kind = time.perf_counter(), path.split("?")[0].split("/")[1] or "search"
        try:
            answer = await client.get(path)
        except httpx.HTTPError as error:
            counts[f"error: {type(error).__name__}"] += 1
            return None
        times.setdefault(kind, []).append(time.perf_counter() - started)
        counts["answers" if answer.status_code == 200 else f"error: {answer.status_code} {path[:60]}"] += 1
        return answer

    async def user(number: int) -> None:
        chance = random.Random(number)
        async with httpx.AsyncClient(base_url=address, timeout=60) as client:
            while time.monotonic() < end:
                query = f"q={chance.choice(WORDS).replace(' ', '+')}&anyway=1{chance.choice(FILTERS)}"
                found = await get(client, f"/?{query}")
                places = re.findall(r'href="/hit/([^"?]+)', found.text) if found else []
                if places:
                    place = unescape(chance.choice(places))
                    await get(client, f"/hit/{place}?{query}")
                    await get(client, f"/above/{place}")
                    await get(client, f"/api/boxes/{place.rsplit('/', 1)[0]}")
                if chance.random() < 0.2:
                    await get(client, f"/save/hits.csv?{query}")
                await asyncio.sleep(chance.uniform(0, 0.5))

    await asyncio.gather(*(user(number) for number in range(users)))
    errors = {kind: items for kind, items in counts.items() if kind.startswith("error")}
    shown = ", ".join(
        f"{kind} {median(taken):.2f} s (95 %: {np.quantile(taken, 0.95):.2f} s)"
        for kind, taken in times.items()
    )
    print(
        f"{users} users for {seconds:g} s: {counts['answers']} answers, {sum(errors.values())} errors {errors or ''}; "
        f"medians: {shown}"
    )
    return not errors


def _browser(address: str) -> bool:
    """Search, open a hit and move the frame in a real browser."""
    from selenium import webdriver
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.ui import WebDriverWait

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for argument in ("headless=new", "no-sandbox", "disable-gpu"):
        options.add_argument(f"--{argument}")
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    try:
        driver.get(address)
        started = time.perf_counter()
        driver.find_element(By.ID, "q").send_keys("red bus", Keys.ENTER)
        WebDriverWait(driver, 60).until(lambda d: d.find_elements(By.CSS_SELECTOR, ".card h3 a"))
        searched = time.perf_counter() - started
        driver.find_element(By.CSS_SELECTOR, ".card h3 a").send_keys(Keys.ENTER)
        shown = "return document.getElementById('scene')?.dataset.shown"
        WebDriverWait(driver, 60).until(lambda d: d.execute_script(shown))
        before = driver.execute_script(shown)
        started = time.perf_counter()
        slider = driver.find_element(By.ID, "at")
        slider.send_keys(Keys.ARROW_LEFT if int(before) else Keys.ARROW_RIGHT)
        WebDriverWait(driver, 60).until(lambda d: d.execute_script(shown) != before)
        moved = time.perf_counter() - started
    finally:
        driver.quit()
    print(
        f"in a real browser: a search {searched:.2f} s until its cards are there, another frame {moved:.2f} s"
    )
    return True


if __name__ == "__main__":
    main()
