"""The layout with which the viewer opens: a 3D view for each layer of points, the cameras, the texts, the time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from upvl_cli.drawing import colours
from upvl_cli.viewer import entities
from upvl_cli.viewer.library import rerun_library
from upvl_cli.viewer.pictures import reduction, size_of

if TYPE_CHECKING:
    from upvl_cli.types import Camera
    from upvl_cli.viewer.scene import DriveScene

_EYE_M, _LOOK_M = (-22.0, 0.0, 16.0), (12.0, 0.0, 0.0)  # from behind and above the car, in ego axes
_MAP_EYE_M = 90.0
_COLUMNS = 2  # of pictures


def blueprint_of(scene: DriveScene, texts: tuple[str, ...]) -> Any:
    """Return the blueprint of a drive.

    Args:
        scene: The drive.
        texts: Names of the texts about it.
    """
    rerun_library()
    import rerun.blueprint as rrb

    layers = scene.layer_names or (None,)
    views = [_layer_view(scene, layer) for layer in layers]
    if scene.poses:
        views.append(_map_view())
    pictures = [_camera_view(scene, camera) for camera in scene.cameras]
    beside: list[Any] = []
    if pictures:
        beside.append(rrb.Grid(*pictures, grid_columns=min(_COLUMNS, len(pictures)), name="cameras"))
    if texts:
        documents = [rrb.TextDocumentView(origin=f"{entities.TEXTS}/{name}", name=name) for name in texts]
        beside.append(rrb.Tabs(*documents, name="about the drive"))
    parts: list[Any] = [rrb.Tabs(*views, name="points by layer")]
    if beside:
        shares = [2.0, 1.0] if len(beside) == 2 else None
        parts.append(rrb.Vertical(*beside, row_shares=shares))
    return rrb.Blueprint(
        rrb.Horizontal(*parts, column_shares=[3.0, 2.0] if beside else None),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline="frame", fps=round(scene.rate_hz, 1), loop_mode="all"),
        auto_layout=False,
        auto_views=False,
    )


def _layer_view(scene: DriveScene, layer: str | None) -> Any:
    """Return the 3D view that goes with the car; `layer` colours its points, None for a drive without points."""
    import rerun as rr
    import rerun.blueprint as rrb
    from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

    overrides: dict[Any, Any] = {}
    if layer is not None:
        mapping = VisualizerComponentMapping(
            target="Points3D:colors",
            source_kind=ComponentSourceKind.SourceComponent,
            source_component=entities.layer_component(layer),
        )
        overrides[entities.POINTS] = rr.Points3D.from_fields().visualizer(mappings=[mapping])
    flat = [f"- {entities.camera_path(camera.name)}/**" for camera in scene.cameras]
    kept = [f"+ {entities.camera_path(camera.name)}" for camera in scene.cameras]
    return rrb.Spatial3DView(
        name=layer or "boxes",
        origin=entities.EGO,
        **_showing(f"+ {entities.WORLD}/**", *flat, *kept),
        overrides=overrides,
        background=colours.BACKGROUND,
        eye_controls=rrb.EyeControls3D(position=_EYE_M, look_target=_LOOK_M, eye_up=(0.0, 0.0, 1.0)),
    )


def _map_view() -> Any:
    """Return the view from above in the world: boxes, past paths of the tracks, the way of the car."""
    import rerun.blueprint as rrb

    shown = (entities.EGO_PATH, entities.TAILS, entities.BOXES, entities.HEADINGS, entities.CAR)
    return rrb.Spatial3DView(
        name="map",
        origin=entities.WORLD,
        **_showing(*(f"+ {path}" for path in shown)),
        background=colours.BACKGROUND,
        eye_controls=rrb.EyeControls3D(
            position=(-1.0, 0.0, _MAP_EYE_M), look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0),
            tracking_entity=entities.CAR,
        ),
    )  # fmt: skip


def _camera_view(scene: DriveScene, camera: Camera) -> Any:
    """Return the picture of a camera with its boxes; names of boxes are hidden until they are switched on."""
    import rerun.blueprint as rrb

    path = entities.camera_path(camera.name)
    width, height = size_of(camera, reduction(camera, scene.options.picture_px))
    return rrb.Spatial2DView(
        name=camera.name,
        origin=path,
        **_showing("+ $origin/**"),
        overrides={f"{path}/names": rrb.EntityBehavior(visible=False)},
        visual_bounds=rrb.VisualBounds2D(x_range=(0.0, width), y_range=(0.0, height)),
    )


def _showing(*query: str) -> dict[str, Any]:
    """Return the argument of a view that names its entities: + adds and - leaves out."""
    return {"contents": list(query)}
