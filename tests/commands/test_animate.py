"""An animated picture of the street: its frames, its length and its size."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from command import fails, upvl
from report.made_up_run import FRAMES, SEGMENT, made_up_run
from upvl_cli.commands.animate import MOST_FRAMES, SECONDS, animate_drive, forward_camera, thin
from upvl_cli.drawing.animation import save_gif, side_by_side
from upvl_cli.errors import BadSetting
from world.street import Streets


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a labelled street."""
    return made_up_run(tmp_path_factory.mktemp("street"), with_points=True).out.parent


@pytest.mark.parametrize("kind", ["webp", "gif"])
def test_every_frame_is_shown_for_a_share_of_the_time(run: Path, kind: str) -> None:
    drawn = animate_drive(made_up_run(run), SEGMENT, kind)
    assert drawn.path == run / "out" / "draw" / f"{SEGMENT}.{kind}"
    assert (drawn.shown, drawn.frames) == (FRAMES, FRAMES)
    assert drawn.size_bytes == drawn.path.stat().st_size < 2_000_000
    with Image.open(drawn.path) as image:
        assert image.n_frames == FRAMES
        assert image.info["loop"] == 0
        durations, pictures = [], []
        for number in range(image.n_frames):
            image.seek(number)
            pictures.append(np.asarray(image.convert("RGB"), dtype=float))
            durations.append(image.info["duration"])
    assert durations == [1000 * SECONDS / FRAMES] * FRAMES
    assert all((first != second).any() for first, second in zip(pictures, pictures[1:], strict=False))


def test_long_drives_are_thinned_evenly() -> None:
    assert thin(tuple(range(5, 5 + MOST_FRAMES))) == tuple(range(5, 5 + MOST_FRAMES))
    assert thin(tuple(range(200))) == tuple(range(0, 200, 5))
    assert len(thin(tuple(range(MOST_FRAMES + 1)))) <= MOST_FRAMES
    assert thin(()) == ()


def test_the_camera_that_looks_ahead_is_chosen() -> None:
    drive = Streets().open(SEGMENT)
    assert forward_camera(drive) is drive.cameras[0]
    drive.cameras = ()
    assert forward_camera(drive) is None


def test_pictures_stand_side_by_side_in_the_middle() -> None:
    above, camera = Image.new("RGB", (100, 400), "red"), Image.new("RGB", (1200, 400), "lime")
    both = side_by_side(above, camera)
    assert both.size == (708, 400)
    assert both.getpixel((50, 200)) == (255, 0, 0)
    assert both.getpixel((400, 200)) == (0, 255, 0)
    assert both.getpixel((400, 60)) == (18, 20, 24)
    assert side_by_side(above, None) is above


def test_a_gif_repeats_for_ever() -> None:
    file = io.BytesIO()
    save_gif([Image.new("RGB", (8, 8), colour) for colour in ("red", "lime", "blue")], 50, file)
    with Image.open(file) as image:
        assert (image.n_frames, image.info["loop"], image.info["duration"]) == (3, 0, 50)


def test_command_tells_the_size_and_refuses_what_it_cannot_draw(run: Path) -> None:
    done = upvl(run, "draw", "--animate", SEGMENT)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"out/draw/{SEGMENT}.webp (0.")
    assert "leave out --frame" in fails(run, "draw", "--animate", "--frame", "3")
    assert "--animate-as png: expected one of gif, webp" in fails(
        run, "draw", "--animate", "--animate-as", "png"
    )
    with pytest.raises(BadSetting, match="expected one of"):
        animate_drive(made_up_run(run), SEGMENT, "mp4")
