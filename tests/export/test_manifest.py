"""Which boxes an export held, as its manifest keeps it."""

from __future__ import annotations

import numpy as np

from export.labelled_drives import labelled_drive
from upvl_cli.export.manifest import Manifest, exported_frames


def test_boxes_between_exported_ones_did_not_go_out() -> None:
    drive = labelled_drive(frames=6)  # frames 3, 5, ..., 13
    taken = (drive.boxes.track_id == 17) & np.isin(drive.boxes.frame, [3, 5, 11])
    frames = exported_frames(drive.with_boxes(drive.boxes[taken]))
    assert frames == {"17": [[3, 5], [11, 11]]}
    manifest = Manifest("csv", "class", {}, {}, {drive.name: frames}, {})
    np.testing.assert_array_equal(manifest.went_out(drive), taken)


def test_labels_that_a_person_deleted_are_known_to_who_edits_the_rest() -> None:
    drive = labelled_drive(frames=2)
    gone = drive.boxes.track_id == 7
    frames = exported_frames(
        type(drive)(
            drive.name,
            drive.frames,
            drive.world_from_ego,
            drive.cameras,
            drive.boxes[~gone],
            deleted=drive.boxes[gone],
        )
    )
    assert frames["7"] == [[3, 5]]
