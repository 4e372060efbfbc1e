"""What nuScenes calls things: categories, classes of its tasks, attributes; and the tokens of an export.

Names after the schema and the rules of its tasks (nuscenes-devkit, docs/schema_nuscenes.md and
python-sdk/nuscenes/eval/detection/README.md).
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence

import numpy as np

from upvl_cli.datasets.nuscenes.drive import NuScenesDrive
from upvl_cli.export.drive import ExportDrive

CATEGORIES = {
    "vehicle": "vehicle.car",
    "pedestrian": "human.pedestrian.adult",
    "cyclist": "vehicle.bicycle",
    "car": "vehicle.car",
    "truck": "vehicle.truck",
    "bus": "vehicle.bus.rigid",
    "trailer": "vehicle.trailer",
    "motorcycle": "vehicle.motorcycle",
    "bicycle": "vehicle.bicycle",
    "excavator": "vehicle.construction",
    "ambulance": "vehicle.emergency.ambulance",
    "police car": "vehicle.emergency.police",
    "child": "human.pedestrian.child",
    "construction worker": "human.pedestrian.construction_worker",
    "police officer": "human.pedestrian.police_officer",
    "stroller": "human.pedestrian.stroller",
    "wheelchair": "human.pedestrian.wheelchair",
    "traffic cone": "movable_object.trafficcone",
    "barrier": "movable_object.barrier",
    "animal": "animal",
}
# Of both tasks; detection has also barrier, construction_vehicle and traffic_cone, which tracking refuses.
TASK_CLASSES = {
    "vehicle": "car",
    "pedestrian": "pedestrian",
    "cyclist": "bicycle",
    "car": "car",
    "truck": "truck",
    "bus": "bus",
    "trailer": "trailer",
    "motorcycle": "motorcycle",
    "bicycle": "bicycle",
}
# The first whose word is in the name of a class decides, after the descriptions of the categories of nuScenes; "" is
# what its tasks do not score.
_TASK_WORDS = (
    ("pedestrian", ("worker", "officer")),
    ("", ("fire", "ambulance", "police", "excavator", "construction", "bulldozer", "crane", "rack", "bay", "toy")),
    ("motorcycle", ("motorcycle", "motorcyclist", "motorbike", "moped", "scooter")),
    ("bicycle", ("bicycle", "bicyclist", "cyclist", "bike")),
    ("bus", ("bus", "coach")),
    ("trailer", ("trailer",)),
    ("truck", ("truck", "lorry", "pickup")),
    ("pedestrian", ("pedestrian", "person", "people", "child", "adult", "man", "woman", "jogger", "walker")),
    ("car", ("car", "vehicle", "van", "taxi", "sedan", "suv", "hatchback", "limousine")),
)  # fmt: skip
ATTRIBUTES = (
    "vehicle.moving",
    "vehicle.stopped",
    "vehicle.parked",
    "pedestrian.moving",
    "pedestrian.standing",
    "pedestrian.sitting_lying_down",
    "cycle.with_rider",
    "cycle.without_rider",
)
VISIBILITIES = {"1": "v0-40", "2": "v40-60", "3": "v60-80", "4": "v80-100"}
_CYCLES = ("bicycle", "motorcycle")
_MOVING_MPS = 0.5  # slower, a vehicle stands: boxes of one that is parked move by a few centimetres a frame
_NUMBER = 1 << 64


def task_class(class_name: str) -> str:
    """Return the class of both tasks that a class is, or is a kind of; empty where there is none."""
    if class_name in TASK_CLASSES.values():
        return class_name
    words = set(re.findall(r"[a-z]+", class_name.lower()))
    return next((name for name, known in _TASK_WORDS if words & set(known)), "")


def attributes_of(drive: ExportDrive, class_names: Sequence[str]) -> list[str]:
    """Return the attribute of each box by its speed; empty where its class has none, or no speed is known.

    Args:
        drive: The drive with n boxes.
        class_names: (n,) categories, or classes of the tasks.
    """
    speed_mps = np.linalg.norm(drive.velocity_world_mps(), axis=1)
    _, track = np.unique(drive.boxes.track_id, return_inverse=True)
    top_mps = np.zeros(track.max(initial=-1) + 1)
    np.maximum.at(top_mps, track, np.nan_to_num(speed_mps))
    return [
        _attribute(name, float(speed), float(top))
        for name, speed, top in zip(class_names, speed_mps, top_mps[track], strict=True)
    ]


def _attribute(class_name: str, speed_mps: float, top_speed_mps: float) -> str:
    if class_name.rpartition(".")[2] in _CYCLES:
        return "cycle.with_rider"
    is_person = class_name == "pedestrian" or class_name.startswith("human.pedestrian.")
    is_vehicle = class_name.startswith("vehicle.") or class_name in TASK_CLASSES.values()
    if not (is_person or is_vehicle) or not speed_mps >= 0:
        return ""
    if is_person:
        return "pedestrian.moving" if speed_mps >= _MOVING_MPS else "pedestrian.standing"
    if speed_mps >= _MOVING_MPS:
        return "vehicle.moving"
    return "vehicle.stopped" if top_speed_mps >= _MOVING_MPS else "vehicle.parked"


def token_of(*parts: object) -> str:
    """Return the token of something by what it is: equal in every export."""
    return hashlib.sha256("/".join(map(str, parts)).encode()).hexdigest()[:32]


def instance_token(drive: str, track: int) -> str:
    """Return the token of a track; its second half is the number of the track."""
    return f"{token_of('instance', drive)[:16]}{int(track) % _NUMBER:016x}"


def track_of(token: str, drive: str) -> str:
    """Return the number of the track that a token of this drive holds, or else the token."""
    head, number = token[:16], token[16:]
    if len(token) == 32 and head == token_of("instance", drive)[:16]:
        try:
            return str(int(number, 16))
        except ValueError:
            return token
    return token


def sample_tokens(drive: ExportDrive) -> list[tuple[str, bool]]:
    """Return the token of each frame, and whether the tasks of nuScenes score it.

    Key frames of nuScenes itself keep their tokens: these alone are scored there. Of any other drive all frames are.
    """
    own = [token_of("sample", drive.name, frame.index) for frame in drive.frames]
    if not isinstance(drive.source, NuScenesDrive):
        return [(token, True) for token in own]
    tokens, taken = [], set()
    for frame, token in zip(drive.frames, own, strict=True):
        sweep = drive.source.sweeps.get(frame.index)
        is_key = sweep is not None and sweep.is_key_frame and sweep.sample not in taken
        name = sweep.sample if sweep is not None and is_key else token
        taken.add(name)
        tokens.append((name, is_key))
    return tokens
