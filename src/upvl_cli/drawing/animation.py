"""A drive over time as one animated picture: from above at the left, a camera at the right."""

from __future__ import annotations

from collections.abc import Sequence
from typing import IO

from PIL import Image

from upvl_cli.drawing import colours

GAP_PX = 8
CAMERA_PX = (600, 400)  # largest width and height of the camera's picture
COLOURS_OF_GIF = 96  # of one palette for all frames: more make the file larger and look the same


def side_by_side(above: Image.Image, camera: Image.Image | None) -> Image.Image:
    """Return the view from above with the picture of a camera to its right, centred from top to bottom.

    Args:
        above: The view from above.
        camera: The picture; None where the drive has none, and the view from above stands alone.
    """
    if camera is None:
        return above
    scale = min(CAMERA_PX[0] / camera.width, CAMERA_PX[1] / camera.height)
    size = round(camera.width * scale), round(camera.height * scale)
    height = max(above.height, size[1])
    canvas = Image.new("RGB", (above.width + GAP_PX + size[0], height), colours.BACKGROUND)
    canvas.paste(above, (0, (height - above.height) // 2))
    shrunk = camera.resize(size, Image.Resampling.LANCZOS)
    canvas.paste(shrunk, (above.width + GAP_PX, (height - size[1]) // 2))
    return canvas


def save_gif(frames: Sequence[Image.Image], duration_ms: int, file: IO[bytes]) -> None:
    """Write frames as an animated GIF that repeats for ever.

    Args:
        frames: The frames, all of one size.
        duration_ms: How long each is shown; browsers know steps of 10 ms.
        file: Where it goes.
    """
    sample = Image.new("RGB", (frames[0].width, frames[0].height * 3))
    for place, number in enumerate((0, len(frames) // 2, len(frames) - 1)):
        sample.paste(frames[number], (0, place * frames[0].height))
    # One palette and no dithering: what does not change between frames costs nothing then.
    palette = sample.quantize(COLOURS_OF_GIF, method=Image.Quantize.MEDIANCUT)
    indexed = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    first, *others = indexed
    first.save(
        file, format="GIF", save_all=True, append_images=others, duration=duration_ms, loop=0, optimize=False
    )


def save_webp(frames: Sequence[Image.Image], duration_ms: int, file: IO[bytes]) -> None:
    """Write frames as an animated WebP that repeats for ever; arguments as for `save_gif`."""
    first, *others = frames
    first.save(
        file,
        format="WEBP",
        save_all=True,
        append_images=others,
        duration=duration_ms,
        loop=0,
        quality=60,
        method=4,
    )
