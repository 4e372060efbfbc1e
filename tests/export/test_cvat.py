"""CVAT's Kitti Raw Format: one car by hand, what CVAT's library reads, and what CVAT gives back."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from export.labelled_drives import labelled_drive
from export.one_car import PointDrive, drive_of_one_car, read, write
from upvl_cli.datasets.shared.point_files.read import read_points
from upvl_cli.errors import BadInput
from upvl_cli.export.drive import ExportBoxes, ExportDrive
from upvl_cli.types import concat


def tracklets(folder: Path) -> list[ElementTree.Element]:
    return ElementTree.parse(folder / "tracklet_labels.xml").getroot().findall("tracklets/item")


def test_a_car_ahead_that_heads_to_the_left(tmp_path: Path) -> None:
    write(drive_of_one_car(), "cvat", tmp_path / "out")
    (item,) = tracklets(tmp_path / "out" / "one")
    # CVAT's sizes: w along the box's x, h along its y, l along its z.
    assert [item.findtext(tag) for tag in ("objectType", "w", "h", "l")] == ["car", "4.0", "2.0", "1.5"]
    assert item.findtext("first_frame") == "0"
    (pose,) = item.findall("poses/item")
    place = [float(pose.findtext(tag, "")) for tag in ("tx", "ty", "tz", "rx", "ry", "rz")]
    assert place == [10.0, 2.0, 0.5, 0.0, 0.0, np.pi / 2]  # the centre, not KITTI's bottom
    assert (tmp_path / "out" / "one" / "frame_list.txt").read_text() == "0 0000000007\n"


def test_a_tracklet_is_a_track_until_it_changes_or_pauses(tmp_path: Path) -> None:
    drive = labelled_drive(frames=5)
    boxes = drive.boxes[drive.boxes.track_id == 7]
    write(drive.with_boxes(boxes), "cvat", tmp_path / "steady")
    assert len(tracklets(tmp_path / "steady" / "bend-1")) == 1
    sizes = boxes.size_lwh_m.copy()
    sizes[3:] += 0.25
    columns = {name: getattr(boxes, name) for name in boxes.__dataclass_fields__} | {"size_lwh_m": sizes}
    changing = ExportBoxes(**columns)[[0, 2, 3, 4]]
    write(drive.with_boxes(changing), "cvat", tmp_path / "changing")
    found = tracklets(tmp_path / "changing" / "bend-1")
    assert [(item.findtext("first_frame"), item.findtext("poses/count")) for item in found] == [
        ("0", "1"),
        ("2", "1"),
        ("3", "2"),
    ]
    back = read("cvat", tmp_path / "changing", drive)
    assert back.track_id.tolist() == [7] * 4
    np.testing.assert_allclose(back.size_lwh_m, changing.size_lwh_m)


def test_the_library_of_cvat_reads_it(tmp_path: Path) -> None:
    dm = pytest.importorskip("datumaro", reason="pip install datumaro, in an environment of its own")
    from packaging.version import Version

    write(drive_of_one_car(), "cvat", tmp_path / "out")
    (item,) = dm.Dataset.import_from(str(tmp_path / "out" / "one"), "kitti_raw")
    (cuboid,) = item.annotations
    assert item.id == "0000000007"
    assert list(cuboid.position) == [10.0, 2.0, 0.5]
    assert list(cuboid.rotation) == [0.0, 0.0, 1.57]  # it keeps hundredths
    # Releases from 1.9 on exchange width and height; CVAT's own copy is older.
    is_older = Version(getattr(dm, "__version__", "0")) < Version("1.9")
    assert list(cuboid.scale) == ([4.0, 2.0, 1.5] if is_older else [2.0, 4.0, 1.5])


def test_the_library_of_cvat_reads_points_and_pictures_beside_it(tmp_path: Path) -> None:
    drive = drive_of_one_car()
    drive = ExportDrive(
        drive.name, drive.frames, drive.world_from_ego, drive.cameras, drive.boxes, PointDrive()
    )
    write(drive, "cvat", tmp_path / "out", with_data=True)
    own = tmp_path / "out" / "one"
    scan = read_points(own / "velodyne_points" / "data" / "0000000007.pcd")
    np.testing.assert_allclose(scan.xyz_m, PointDrive.xyz_ego_m)
    assert (own / "image_00" / "data" / "0000000007.png").is_file()


RETURNED = """<?xml version="1.0" encoding="UTF-8" standalone="yes"?>
<!DOCTYPE boost_serialization>
<boost_serialization version="9" signature="serialization::archive">
  <tracklets version="0" tracking_level="0" class_id="0"><count>2</count><item_version>1</item_version>
    <item version="1" tracking_level="0" class_id="1">
      <objectType>car</objectType><h>2.0</h><w>4.0</w><l>1.5</l><first_frame>0</first_frame>
      <poses version="0" tracking_level="0" class_id="2"><count>2</count><item_version>2</item_version>
        <item version="1" tracking_level="0" class_id="3"><tx>1.0</tx><ty>2.0</ty><tz>3.0</tz><rx>0</rx><ry>0</ry>
          <rz>-1.5</rz><state>2</state><occlusion>1</occlusion><truncation>0</truncation></item>
        <item><tx>9.0</tx><ty>9.0</ty><tz>9.0</tz><rx>0</rx><ry>0</ry><rz>0</rz><truncation>2</truncation></item>
      </poses><finished>1</finished></item>
    <item><objectType>bus</objectType><h>3</h><w>12</w><l>3</l><first_frame>1</first_frame>
      <poses><count>1</count><item><tx>5</tx><ty>6</ty><tz>7</tz><rx>0</rx><ry>0</ry><rz>1</rz></item></poses></item>
  </tracklets>
</boost_serialization>"""


def test_what_cvat_exports_is_read(tmp_path: Path) -> None:
    """Tracks of its own, no attributes, poses outside, and paths in the list of frames."""
    own = tmp_path / "back" / "bend-1"
    own.mkdir(parents=True)
    (own / "tracklet_labels.xml").write_text(RETURNED)
    (own / "frame_list.txt").write_text(
        "# made by a tool\n0 velodyne_points/data/0000000003\n1 0000000005.pcd\n"
    )
    boxes = read("cvat", tmp_path / "back", labelled_drive())
    assert boxes.frame.tolist() == [3, 5] and boxes.class_name.tolist() == ["car", "bus"]
    assert boxes.track_id.tolist() == [0, 1] and boxes.score.tolist() == [1.0, 1.0]
    np.testing.assert_allclose(boxes.to_rows()[0], [1, 2, 3, 4, 2, 1.5, -1.5])
    # Of one drive alone, not in a folder of its name.
    again = read("cvat", own, labelled_drive())
    assert again.frame.tolist() == [3, 5]
    (own / "frame_list.txt").unlink()  # then frames count from 0
    assert read("cvat", own, labelled_drive()).frame.tolist() == [3, 5]


def test_a_folder_that_does_not_say_of_which_drive_is_refused(tmp_path: Path) -> None:
    write(drive_of_one_car(), "cvat", tmp_path / "out")
    drives = {name: labelled_drive(name) for name in ("bend-1", "bend-2")}
    from upvl_cli.export.cvat import FORMAT

    (tmp_path / "out" / "one").rename(tmp_path / "task 3")
    with pytest.raises(BadInput, match="does not say of which; put it into a folder that bears the name"):
        FORMAT.read(tmp_path / "task 3", drives)


@pytest.mark.parametrize(
    "declared",
    [
        '<!DOCTYPE a [<!ENTITY b "bbbbbbbbbb"><!ENTITY c "&b;&b;&b;&b;&b;&b;">]>',
        "<!DOCTYPE boost_serialization [<!ELEMENT a ANY>]>",
    ],
)
def test_entities_are_refused_before_they_grow(declared: str, tmp_path: Path) -> None:
    own = tmp_path / "one"
    own.mkdir()
    text = RETURNED.replace("<!DOCTYPE boost_serialization>", declared).replace("car", "&c;")
    (own / "tracklet_labels.xml").write_text(text)
    with pytest.raises(BadInput, match="declares XML entities"):
        read("cvat", tmp_path, drive_of_one_car())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<w>4.0</w>", "", "tracklet 0 has no w; expected a number"),
        ("<w>4.0</w>", "<w>nan</w>", "tracklet 0, w is 'nan'; expected a number"),
        ("<objectType>car</objectType>", "<objectType/>", "tracklet 0 has no objectType"),
        ("<first_frame>1</first_frame>", "<first_frame>9</first_frame>", "pose 0 is of frame 9"),
        ("</tracklets>", "", "is not whole XML"),
        ("<w>4.0</w>", "<w>-4</w>", "has no size or no place"),
    ],
)
def test_faults_are_named(old: str, new: str, message: str, tmp_path: Path) -> None:
    own = tmp_path / "bend-1"
    own.mkdir()
    assert old in RETURNED
    (own / "tracklet_labels.xml").write_text(RETURNED.replace(old, new, 1))
    with pytest.raises(BadInput, match=message):
        read("cvat", tmp_path, labelled_drive())


@pytest.mark.parametrize("line", ["0 ../../etc/passwd", "0", "x 0000000003", "0 frame_3"])
def test_a_list_of_frames_names_frames_alone(line: str, tmp_path: Path) -> None:
    write(drive_of_one_car(), "cvat", tmp_path / "out")
    (tmp_path / "out" / "one" / "frame_list.txt").write_text(line + "\n")
    with pytest.raises(BadInput, match="frame_list.txt, line 1"):
        read("cvat", tmp_path / "out", drive_of_one_car())


def test_a_drive_without_boxes_has_an_empty_list(tmp_path: Path) -> None:
    drive = drive_of_one_car().with_boxes(concat([], ExportBoxes))
    write(drive, "cvat", tmp_path / "out")
    assert tracklets(tmp_path / "out" / "one") == []
    assert len(read("cvat", tmp_path / "out", drive)) == 0
