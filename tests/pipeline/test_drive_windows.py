"""A drive that is made in windows has the same shard, byte for byte, as one that is made as a whole."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from command import make_workspace
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.errors import BadSetting, NotMade
from upvl_cli.pipeline.executors.share import Share
from upvl_cli.pipeline.runner import claim_folder, make_shard
from upvl_cli.pipeline.stage import WHOLE_DATASET, FrameWindow
from upvl_cli.pipeline.tables import read_footer
from upvl_cli.pipeline.windows import join_windows, make_window, missing_windows, run_window, windows_of
from upvl_cli.pipeline.workspace import Workspace
from upvl_cli.types import Frame

SEGMENT = "street-0"
WINDOWED = [stage.name for stage in PIPELINE.stages if stage.windowed]
STAGES = (
    "odometry", "ground", "flow", "pca", "extract-vl", "mask", "boxes2d", "propose", "track", "amodal", "nms",
    "looks", "pool-features",
)  # fmt: skip


def nothing() -> None:
    """Nobody counts."""


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workspace]:
    """A workspace with all that the stages in windows read, and their shards."""
    folder = make_workspace(tmp_path_factory.mktemp("windows"), **{"extract-vl__images": '"all"'})
    before = os.getcwd()
    os.chdir(folder)
    try:
        found = Workspace(PIPELINE, Path("stages"), Path("out"))
        for name in STAGES:
            stage = PIPELINE.by_name[name]
            settings = claim_folder(found, stage, {})
            make_shard(found, stage, WHOLE_DATASET if stage.is_of_dataset else SEGMENT, settings, nothing)
        yield found
    finally:
        os.chdir(before)


def test_some_stages_can_be_made_in_windows() -> None:
    assert WINDOWED == ["ground", "flow", "extract-vl", "boxes2d", "pool-features"]


def test_whoever_makes_the_last_window_joins_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(make_workspace(tmp_path / "w"))
    found = Workspace(PIPELINE, Path("stages"), Path("out"))
    for name in ("odometry", "ground"):
        make_shard(
            found,
            PIPELINE.by_name[name],
            SEGMENT,
            claim_folder(found, PIPELINE.by_name[name], {}),
            nothing,
        )
    stage, path = PIPELINE.by_name["ground"], found.shard("ground", SEGMENT)
    settings, expected = found.settings(stage), path.read_bytes()
    path.unlink()
    said = [run_window(found, stage, SEGMENT, Share(number, 3), settings) for number in (3, 1, 1, 2, 2)]
    assert said == [
        "window 3 of 3 made, 2 missing",
        "window 1 of 3 made, 1 missing",
        "window 1 of 3 was made, 1 missing",
        "all windows are made; the shard is fresh",
        "all windows are made; the shard is fresh",
    ]
    assert path.read_bytes() == expected
    assert run_window(found, stage, SEGMENT, Share(99, 99), settings).endswith("no window 99")


@pytest.mark.slow
@pytest.mark.parametrize("name", WINDOWED)
def test_windows_joined_are_the_bytes_of_the_whole(workspace: Workspace, name: str) -> None:
    stage, path = PIPELINE.by_name[name], workspace.shard(name, SEGMENT)
    settings, whole = workspace.settings(stage), path.read_bytes()
    path.unlink()
    windows = windows_of(workspace, SEGMENT, 3)
    ticks: list[int] = []
    for number, window in enumerate(reversed(windows)):
        assert len(missing_windows(workspace, stage, SEGMENT, windows, settings)) == 3 - number
        with pytest.raises(NotMade, match="windows are not made"):
            join_windows(workspace, stage, SEGMENT, windows, settings)
        assert not path.exists()
        assert make_window(workspace, stage, SEGMENT, window, settings, lambda: ticks.append(1))
        assert not make_window(workspace, stage, SEGMENT, window, settings, nothing)  # it is fresh
    made = join_windows(workspace, stage, SEGMENT, windows, settings)
    footer = read_footer(path)
    assert footer is not None
    assert (made.fresh, made.rows, len(ticks)) == (False, footer.rows, footer.rows)
    assert path.read_bytes() == whole
    assert not (path.parent / ".parts").exists()
    assert join_windows(workspace, stage, SEGMENT, windows, settings).fresh
    assert not make_window(workspace, stage, SEGMENT, windows[0], settings, nothing)  # the shard has it


@pytest.mark.slow
def test_windows_of_other_settings_are_not_joined(workspace: Workspace) -> None:
    stage = PIPELINE.by_name["ground"]
    path = workspace.shard("ground", SEGMENT)
    whole = path.read_bytes()
    path.unlink()
    windows = windows_of(workspace, SEGMENT, 2)
    settings = workspace.settings(stage)
    other = workspace.with_values(stage, {"max_height_m": 0.123})
    make_window(workspace, stage, SEGMENT, windows[0], other, nothing)
    make_window(workspace, stage, SEGMENT, windows[1], settings, nothing)
    assert missing_windows(workspace, stage, SEGMENT, windows, settings) == [windows[0]]
    make_window(workspace, stage, SEGMENT, windows[0], settings, nothing)
    join_windows(workspace, stage, SEGMENT, windows, settings)
    assert path.read_bytes() == whole


def test_a_stage_that_needs_the_whole_drive_is_refused(tmp_path: Path) -> None:
    stage = PIPELINE.by_name["track"]
    nowhere = Workspace(PIPELINE, tmp_path / "stages", tmp_path / "out")
    for action in (
        lambda: make_window(nowhere, stage, SEGMENT, FrameWindow(0, 5), None, nothing),  # type: ignore[arg-type]
        lambda: join_windows(nowhere, stage, SEGMENT, [FrameWindow(0, 5)], None),  # type: ignore[arg-type]
    ):
        with pytest.raises(BadSetting, match="track needs the whole drive"):
            action()


class FramesAlone:
    """A workspace of one drive, of which only the numbers of the frames count."""

    def __init__(self, numbers: list[int]) -> None:
        self.frames = [Frame(number, number * 10**8) for number in numbers]

    def drive(self, segment: str) -> FramesAlone:
        return self


@pytest.mark.parametrize(
    ("numbers", "windows", "expected"),
    [
        (list(range(10)), 2, [(0, 5), (5, 10)]),
        (list(range(10)), 3, [(0, 3), (3, 6), (6, 10)]),
        (list(range(10)), 1, [(0, 10)]),
        ([3, 4, 9, 20], 2, [(0, 9), (9, 21)]),  # gaps
        ([3, 4], 5, [(0, 4), (4, 5)]),  # fewer frames than windows
        ([], 5, [(0, 1)]),
    ],
)
def test_windows_cover_each_frame_once(
    numbers: list[int], windows: int, expected: list[tuple[int, int]]
) -> None:
    found = windows_of(FramesAlone(numbers), SEGMENT, windows)  # type: ignore[arg-type]
    assert [(window.first, window.end) for window in found] == expected
    assert all(sum(number in window for window in found) == 1 for number in numbers)
