"""A drive on a slope and round a bend, with cars that drive along their headings: exact by construction."""

from __future__ import annotations

import numpy as np

from upvl_cli.export.drive import ExportBoxes, ExportDrive
from upvl_cli.geometry.se3 import apply, from_yaw, inverse, rotate
from upvl_cli.types import Camera, Frame, concat

STEP_NS = 100_000_000
START_NS = 1_500_000_000_123_456_789  # as data sets have it: more than a double holds
FORWARD = np.array([[0.0, 0, 1, 1.5], [-1, 0, 0, 0.2], [0, -1, 0, 1.6], [0, 0, 0, 1]])
CLASSES = ("vehicle", "pedestrian", "cyclist", "other", "fire truck")


def labelled_drive(name: str = "bend-1", frames: int = 6, first_index: int = 3) -> ExportDrive:
    """A drive whose frames count from 3, in tilted world axes; five objects, one of which no camera sees."""
    times_s = np.arange(frames) * STEP_NS * 1e-9
    poses = np.array([_pose(time_s) for time_s in times_s])
    parts = []
    for place in range(frames):
        for track, class_name in enumerate(CLASSES):
            parts.append(_object(track, class_name, place, times_s[place], poses[place], first_index))
    index = [Frame(first_index + 2 * place, START_NS + place * STEP_NS) for place in range(frames)]
    boxes = concat(parts, ExportBoxes)
    return ExportDrive(name, tuple(index), poses, (camera("front", 0.0), camera("left", np.pi / 2)), boxes)


def camera(name: str, yaw_rad: float) -> Camera:
    """A pinhole that is pitched a little, as those of real cars are."""
    pitch = np.eye(4)
    pitch[1:3, 1:3] = [[np.cos(0.02), -np.sin(0.02)], [np.sin(0.02), np.cos(0.02)]]
    pose = from_yaw(yaw_rad, np.zeros(3)) @ FORWARD @ pitch
    return Camera(name, 640, 480, np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), np.zeros(5), pose)


def _pose(time_s: float) -> np.ndarray:
    """The ego at 10 m/s round a bend, on a road that climbs by 3 degrees and leans by 2."""
    yaw = 0.7 + 0.4 * time_s
    slope = np.eye(4)
    cp, sp, cr, sr = np.cos(-0.05), np.sin(-0.05), np.cos(0.035), np.sin(0.035)
    slope[:3, :3] = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @ np.array(
        [[1, 0, 0], [0, cr, -sr], [0, sr, cr]]
    )
    place = [1000.0 + 10 * time_s * np.cos(yaw), 500 + 10 * time_s * np.sin(yaw), 40 + 0.5 * time_s]
    return from_yaw(yaw, np.array(place)) @ slope


def _object(
    track: int, class_name: str, place: int, time_s: float, world_from_ego: np.ndarray, first_index: int
) -> ExportBoxes:
    """One object that moves along its heading; its height over the sloping road is that of the ego's axes."""
    heading_world = 0.7 + 1.1 * track
    speed = 2.0 + track
    start = _pose(0.0)[:3, 3] + [12 * np.cos(track * 1.3 + 0.7), 12 * np.sin(track * 1.3 + 0.7), 0.0]
    along = np.array([np.cos(heading_world), np.sin(heading_world), 0.0])
    center = apply(inverse(world_from_ego), (start + along * speed * time_s)[None])
    velocity = rotate(inverse(world_from_ego), (along * speed)[None])
    return ExportBoxes(
        center,
        np.array([[4.0 - 0.3 * track, 1.8 - 0.2 * track, 1.5 + 0.1 * track]]),
        np.arctan2(velocity[:, 1], velocity[:, 0]),
        velocity,
        np.array([0.25 + 0.15 * track]),
        np.array([7 + 10 * track]),
        frame=np.array([first_index + 2 * place]),
        class_name=np.array([class_name]),
        num_points=np.array([11 * track]),
    )
