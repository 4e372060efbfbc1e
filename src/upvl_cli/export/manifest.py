"""`upvl.json` of an export: which labels went out, by which names, and what the format could not carry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportDrive
from upvl_cli.export.text import read_json
from upvl_cli.types import Bools

MANIFEST = "upvl.json"
NAMES = ("class", "word")  # which column of the labels named the boxes


@dataclass(frozen=True)
class Manifest:
    """What an export says of itself.

    Attributes:
        format: Name of the format; empty where nobody says.
        names: "class" or "word".
        classes: Class of upvl by class of the format.
        digests: Digest of the labels of each drive.
        frames: Of each drive and track the first and the last frame of each row of frames that went out.
        not_carried: What the format could not carry, by reason.
    """

    format: str
    names: str
    classes: Mapping[str, str]
    digests: Mapping[str, str]
    frames: Mapping[str, Mapping[str, list[list[int]]]]
    not_carried: Mapping[str, int]

    @staticmethod
    def unknown() -> Manifest:
        """Return the manifest of files that only a tool has made."""
        return Manifest("", NAMES[0], {}, {}, {}, {})

    def as_json(self) -> dict[str, Any]:
        """Return what is written."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    def went_out(self, drive: ExportDrive) -> Bools:
        """Return (n,) which boxes of a drive the export held; all of them where nobody says."""
        if drive.name not in self.frames:
            return np.ones(len(drive.boxes), dtype=np.bool_)
        taken = np.zeros(len(drive.boxes), dtype=np.bool_)
        for track, spans in self.frames[drive.name].items():
            of_track = drive.boxes.track_id == int(track)
            for first, last in spans:
                taken |= of_track & (drive.boxes.frame >= first) & (drive.boxes.frame <= last)
        return taken


def exported_frames(drive: ExportDrive) -> dict[str, list[list[int]]]:
    """Return of each track the first and the last frame of each row of frames without a gap."""
    found: dict[str, list[list[int]]] = {}
    known = [(boxes.frame, boxes.track_id) for boxes in (drive.boxes, drive.deleted) if boxes is not None]
    places, tracks = (
        drive.places_of(np.concatenate([f for f, _ in known])),
        np.concatenate([t for _, t in known]),
    )
    for track in np.unique(tracks).tolist():
        own = np.unique(places[tracks == track])
        parts = np.split(own, np.flatnonzero(np.diff(own) > 1) + 1)
        found[str(track)] = [[drive.frames[part[0]].index, drive.frames[part[-1]].index] for part in parts]
    return found


def read_manifest(folder: Path, name: str) -> Manifest:
    """Return the manifest of an export; that of nobody where a tool has not kept the file.

    Raises:
        BadInput: The file is none of upvl, or of another format.
    """
    path = folder / MANIFEST
    if not path.is_file():
        return Manifest.unknown()
    values = read_json(path)
    try:
        manifest = Manifest(
            str(values["format"]),
            str(values["names"]),
            {str(key): str(value) for key, value in values["classes"].items()},
            {str(key): str(value) for key, value in values["digests"].items()},
            {str(key): _spans(value) for key, value in values["frames"].items()},
            {},
        )
    except (KeyError, TypeError, ValueError, AttributeError):
        raise BadInput(f"{path} is no manifest of upvl; remove it, or export again") from None
    if manifest.names not in NAMES:
        raise BadInput(f"{path}: names is {manifest.names[:40]!r}, expected {' or '.join(NAMES)}")
    if manifest.format != name:
        raise BadInput(f"{folder} is of the format {manifest.format[:40]!r}, not {name!r}; name that format")
    return manifest


def _spans(tracks: Mapping[str, list[list[int]]]) -> dict[str, list[list[int]]]:
    return {
        str(int(track)): [[int(first), int(last)] for first, last in spans] for track, spans in tracks.items()
    }
