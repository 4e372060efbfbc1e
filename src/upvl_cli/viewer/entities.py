"""Where the parts of a drive stand in a recording, by their paths."""

from __future__ import annotations

WORLD = "/world"
EGO = "/world/ego"
CAR = "/world/ego/car"
POINTS = "/world/ego/points"
BOXES = "/world/ego/boxes"
HEADINGS = "/world/ego/headings"
EGO_PATH = "/world/ego_path"
TAILS = "/world/tails"
CAMERAS = "/world/ego/cameras"
TEXTS = "/about"

LAYERS = "layers"  # the archetype of the colours of points: its components are the names of the layers

LABEL = "label"  # the archetype of what is known of each box


def camera_path(name: str) -> str:
    """Return the path of a camera; its name may have any letters."""
    from upvl_cli.viewer.library import rerun_library

    return f"{CAMERAS}/{rerun_library().escape_entity_path_part(name)}"


def layer_component(layer: str) -> str:
    """Return the component with the colours of the points in a layer."""
    return f"{LAYERS}:{layer}"
