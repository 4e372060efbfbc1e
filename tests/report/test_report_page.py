"""The page whole: it opens without network, escapes what it shows, and stays small."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from command import fails, upvl
from report.made_up_run import FRAMES, SEGMENT, THINGS, Thing, log_runs, made_up_run, write_labels
from upvl_cli.errors import BadSetting, NotMade
from upvl_cli.report import run_summary
from upvl_cli.report.page import without_folders
from upvl_cli.report.run import write_report

EVIL = "<script>alert(1)</script>"


class PageReader(HTMLParser):
    """What a browser would do with a page: its tags with their attributes, and its text outside of styles."""

    VOID = {"meta", "link", "img", "br", "input", "hr"}

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.open: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] != "style":
            self.texts.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.texts).split())

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def read(path: Path) -> PageReader:
    return PageReader(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of the made-up run."""
    workspace = made_up_run(tmp_path_factory.mktemp("run"), with_points=True)
    log_runs(workspace, labels=2.0, nms=4.0)
    return write_report(workspace, (), workspace.out / "report.html").path


def test_page_is_whole_and_fetches_nothing(page: Path) -> None:
    found, source = read(page), page.read_text()
    assert not found.open  # every tag is closed
    assert {tag for tag, _ in found.tags} & {
        "script",
        "link",
        "iframe",
        "object",
        "embed",
        "base",
        "form",
    } == set()
    for tag, attributes in found.tags:
        assert not [name for name in attributes if name.startswith("on")]
        for name in ("src", "href", "srcset", "data", "action", "xlink:href"):
            value = attributes.get(name)
            assert value is None or value.startswith(("#", "data:image/jpeg;base64,")), (tag, name)
    assert not re.search(r"url\(|@import|https?:", source)


def test_page_can_be_read_on_a_phone_and_by_a_screen_reader(page: Path) -> None:
    found = read(page)
    assert {"name": "viewport", "content": "width=device-width, initial-scale=1"} in found.all("meta")
    assert "prefers-color-scheme: dark" in page.read_text()
    assert found.all("html")[0]["lang"] == "en"
    assert all(image["alt"] for image in found.all("img")) and len(found.all("img")) >= 4
    assert all(figure.get("role") == "img" and figure["aria-label"] for figure in found.all("svg"))
    headings = [tag for tag, _ in found.tags if re.fullmatch("h[1-6]", tag)]
    assert headings[0] == "h1" and headings.count("h1") == 1 and headings[1] == "h2"
    ids = {attributes.get("id") for _, attributes in found.tags}
    assert {(link["href"] or "")[1:] for link in found.all("a")} <= ids


def test_page_has_the_counts_of_the_run(page: Path) -> None:
    text = read(page).text
    assert f"frames {FRAMES} duration 0.5 s distance driven 5 m boxes 24 of them moving 12 tracks 4" in text
    assert "tracks that move 2 tracks parked 2" in text
    # Class, tracks, moving, parked, boxes, size, speed of moving boxes, score.
    assert "vehicle 3 2 1 18 4.0 2.0 1.6 7.5 0.75" in text
    assert "unknown 1 0 1 6 0.8 2.0 1.6 – 0.75" in text
    assert "nms 4.0 s 667 ms 104 MiB 1" in text
    assert "7 boxes dropped: overlap a better one 24 boxes kept" in text


def test_page_is_the_same_twice_and_says_nothing_of_the_machine(page: Path) -> None:
    folder = page.parents[1]
    workspace = run_summary.Workspace(
        made_up_run(folder, with_points=True).pipeline, folder / "stages", folder / "out"
    )
    again = write_report(workspace, (), folder / "again.html").path
    assert again.read_bytes() == page.read_bytes()
    assert str(folder) not in page.read_text()


def test_what_is_missing_is_named_with_its_command(page: Path) -> None:
    text = read(page).text
    assert "scores nothing was compared with human labels upvl eval" in text
    assert f"sensors are measured by the full check upvl check {SEGMENT}" in text
    assert "boxes of the detector none were made upvl train, then: upvl detect" in text


def test_hostile_names_are_escaped(tmp_path: Path) -> None:
    things = (Thing(1, 5, 0, class_name=EVIL, word=f'"><img src=x onerror=alert(1)>{EVIL}'), *THINGS[1:])
    workspace = made_up_run(tmp_path, things)
    (workspace.out / "eval").mkdir()
    (workspace.out / "eval" / "labels-all.json").write_text(json.dumps({"scope": EVIL}))
    found = read(write_report(workspace, (), tmp_path / "page.html").path)
    assert not found.open
    assert not found.all("script")
    assert all((image["src"] or "").startswith("data:") for image in found.all("img"))
    assert EVIL in found.text


def test_a_drive_with_a_hostile_name_is_escaped(tmp_path: Path, monkeypatch) -> None:
    name = "<img src=x onerror=alert(1)>"
    workspace = made_up_run(tmp_path)
    write_labels(workspace, segment=name)
    monkeypatch.setattr(type(workspace), "segments", (SEGMENT, name))
    found = read(write_report(workspace, (), tmp_path / "page.html").path)
    assert not found.open
    assert all((image["src"] or "").startswith("data:") for image in found.all("img"))
    assert f"{name} 6 0.5 s 5 24 4 2 2" in found.text


@pytest.mark.parametrize(
    ("text", "shared"),
    [
        ("/home/me/drives/a.parquet is damaged", "…/a.parquet is damaged"),
        ('"/data/kitti"', '"…/kitti"'),
        ("root=/srv/x/y", "root=…/y"),
        ("C:/Users/me/x.bin", "…/x.bin"),
        ("4.2 m/s, 3/4 of out/labels/a.parquet", "4.2 m/s, 3/4 of out/labels/a.parquet"),
        ("../shared/data", "../shared/data"),
    ],
)
def test_absolute_paths_lose_their_folders(text: str, shared: str) -> None:
    assert without_folders(text) == shared


def test_many_drives_stay_below_ten_megabytes(tmp_path: Path, monkeypatch) -> None:
    """Room for pictures and maps is shared; with little of both the page names what it leaves out."""
    workspace = made_up_run(tmp_path, with_points=True)
    names = [SEGMENT, *(f"street-{number}" for number in range(1, 40))]
    for name in names[1:]:
        write_labels(workspace, segment=name)
    monkeypatch.setattr(run_summary, "PICTURE_BYTES", 20_000)
    monkeypatch.setattr(run_summary, "MAP_BYTES", 30_000)
    monkeypatch.setattr(type(workspace), "segments", tuple(sorted(names)))
    written = write_report(workspace, (), tmp_path / "page.html")
    page = read(written.path)
    assert written.size_bytes < 500_000
    assert "drives 40 frames 240" in page.text
    assert "has no room for 35 of 40 maps" in page.text
    assert "has no room for pictures of" in " ".join(written.notes)
    assert sum(len(image["src"] or "") for image in page.all("img")) <= 20_000


def test_a_drive_that_cannot_be_read_any_more_still_has_its_labels(tmp_path: Path) -> None:
    workspace = made_up_run(tmp_path)
    raw = tmp_path / "stages" / "raw.toml"
    raw.write_text('dataset = "kitti"\nroot = "/nowhere/at/all"\nsegments = []\n')
    workspace = run_summary.Workspace(workspace.pipeline, workspace.stages, workspace.out)
    written = write_report(workspace, (), tmp_path / "page.html")
    text = read(written.path).text
    assert "boxes 24" in text
    assert any(note.startswith("missing: verdict") for note in written.notes)
    assert "/nowhere/at" not in written.path.read_text()
    assert any(note.startswith(f"missing: pictures of {SEGMENT}") for note in written.notes)


def test_labels_made_with_other_settings_are_told(tmp_path: Path) -> None:
    stamp = json.dumps({"nms": {"version": 1, "values": {"max_iou": 0.123}}, "vlm": {"model": "mini"}})
    workspace = made_up_run(tmp_path)
    write_labels(workspace, stamp=stamp)
    text = read(write_report(workspace, (), tmp_path / "page.html").path).text
    assert f"stale: {SEGMENT}: its labels were made with something else" in text
    assert "nms.max_iou 0.2 0.123" in text


def test_wrong_drives_and_folders_are_refused(tmp_path: Path) -> None:
    workspace = made_up_run(tmp_path)
    with pytest.raises(BadSetting, match="unknown segment 'street-9'"):
        write_report(workspace, ["street-9"], tmp_path / "page.html")
    with pytest.raises(BadSetting, match="this is a folder"):
        write_report(workspace, (), tmp_path)
    with pytest.raises(BadSetting, match="the folder of the results themselves"):
        write_report(workspace, (), tmp_path / "page.html", workspace.out)
    with pytest.raises(BadSetting, match="no such folder"):
        write_report(workspace, (), tmp_path / "page.html", tmp_path / "out9")
    workspace.shard("labels", SEGMENT).unlink()
    with pytest.raises(NotMade, match=f"{SEGMENT} has not been labelled"):
        write_report(workspace, [SEGMENT], tmp_path / "page.html")
    with pytest.raises(NotMade, match="run: upvl autolabel"):
        write_report(workspace, (), tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()


def test_command_names_the_page_and_what_it_lacks(tmp_path: Path) -> None:
    made_up_run(tmp_path)
    done = upvl(tmp_path, "report", "--to", "here.html")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert re.fullmatch(r"here\.html \(0\.\d MB\)", lines[-1])
    assert "missing: scores (nothing was compared with human labels); run: upvl eval" in lines
    assert "--against out: this is the folder of the results" in fails(tmp_path, "report", "--against", "out")
