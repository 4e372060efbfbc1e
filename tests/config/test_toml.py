"""Values are checked against their declarations, and every fault is named."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest

from upvl_cli.config.base import Config, setting, settings_of, table
from upvl_cli.config.toml import load, merge
from upvl_cli.errors import BadSetting
from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.pipeline.workspace import RawConfig
from upvl_cli.stages import STAGES


@dataclass(frozen=True)
class Inner(Config):
    eps_m: float = setting("a distance", "m", ge=0.1, le=10)
    names: tuple[str, ...] = setting("some names")


@dataclass(frozen=True)
class Settings(Config):
    speed_mps: float = setting("a speed", "m/s", gt=0, le=80)
    points: int = setting("a number of points", ge=3)
    method: Literal["fast", "slow"] = setting("how")
    names: tuple[str, ...] = setting("some names")
    sizes_m: tuple[float, ...] = setting("some sizes", "m", ge=0, le=9)
    is_on: bool = setting("a switch")
    inner: Inner = table("settings of a part")


GOOD = """
speed_mps = 4
points = 5
method = "fast"
names = ["a"]
sizes_m = [1, 2.5]
is_on = true
[inner]
eps_m = 0.5
names = ["b", "c"]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "it.toml"
    path.write_text(text)
    return path


def test_values_come_in_their_declared_types(tmp_path: Path) -> None:
    expected = Settings(4.0, 5, "fast", ("a",), (1.0, 2.5), True, Inner(0.5, ("b", "c")))
    found = load(Settings, written(tmp_path, GOOD))
    assert found == expected
    assert [type(found.speed_mps), type(found.sizes_m[0])] == [float, float]
    assert hash(found) == hash(expected)  # nothing in it can be changed


def test_values_of_the_command_line_win(tmp_path: Path) -> None:
    found = load(Settings, written(tmp_path, GOOD), {"points": 7, "inner": {"eps_m": 2.0}})
    assert (found.points, found.inner) == (7, Inner(2.0, ("b", "c")))


def test_tables_are_merged_key_by_key() -> None:
    below = {"a": 1, "t": {"x": 1, "y": 2}}
    assert merge(below, {"t": {"y": 3}, "u": {"z": 4}}) == {"a": 1, "t": {"x": 1, "y": 3}, "u": {"z": 4}}
    assert below == {"a": 1, "t": {"x": 1, "y": 2}}


def test_settings_are_listed_with_those_of_tables() -> None:
    listed = {spec.name: spec for spec in settings_of(Settings)}
    assert list(listed)[-2:] == ["inner.eps_m", "inner.names"]
    assert listed["inner.eps_m"].bounds == ">= 0.1 and <= 10"
    assert listed["method"].choices == ("fast", "slow")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("points = 5", "ponts = 5", "unknown key 'ponts'; did you mean 'points'? (known: speed_mps, points,"),
        ("points = 5", "", "missing key 'points' (a number of points)"),
        ("speed_mps = 4", "speed_mps = 0", "speed_mps = 0 must be > 0 and <= 80 m/s (a speed)"),
        ("speed_mps = 4", "speed_mps = nan", "speed_mps = nan must be > 0"),
        ("speed_mps = 4", 'speed_mps = "4"', "speed_mps = '4' must be a number"),
        ("speed_mps = 4", "speed_mps = true", "speed_mps = True must be a number"),
        ("points = 5", "points = 5.5", "points = 5.5 must be a whole number"),
        ("points = 5", "points = 2", "points = 2 must be >= 3 (a number of points)"),
        ('"fast"', '"quick"', "method = 'quick' must be one of fast, slow (how)"),
        ('["a"]', '"a"', "names = 'a' must be a list of texts"),
        ('["a"]', "[1]", "names[0] = 1 must be a text"),
        ("points = 5", "points = true", "points = True must be a whole number"),
        ("is_on = true", "is_on = 1", "is_on = 1 must be true or false"),
        ("[1, 2.5]", "[1, 99]", "sizes_m[1] = 99 must be >= 0 and <= 9 m (some sizes)"),
        ("[1, 2.5]", "[1, inf]", "sizes_m[1] = inf must be"),
        ("speed_mps = 4", f"speed_mps = 1{'0' * 400}", "must be > 0 and <= 80 m/s"),
        ("eps_m = 0.5", "eps_m = 50", "inner.eps_m = 50 must be >= 0.1 and <= 10 m (a distance)"),
        ("eps_m = 0.5", "eps = 0.5", "unknown key 'inner.eps'; did you mean 'eps_m'? (known: eps_m, names)"),
        ("eps_m = 0.5", "", "missing key 'inner.eps_m' (a distance)"),
        ('[inner]\neps_m = 0.5\nnames = ["b", "c"]', "inner = 3", "inner = 3 must be a table of settings"),
        ("points = 5", "points =", "is not valid TOML"),
    ],
)
def test_a_wrong_value_is_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(BadSetting) as caught:
        load(Settings, written(tmp_path, GOOD.replace(old, new)))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_all_faults_are_told_at_once(tmp_path: Path) -> None:
    with pytest.raises(BadSetting, match="points = 2.*method = 'x'"):
        load(Settings, written(tmp_path, GOOD.replace("5", "2").replace("fast", "x")))


def test_a_missing_file_says_how_to_make_a_workspace(tmp_path: Path) -> None:
    with pytest.raises(BadSetting, match="upvl init"):
        load(Settings, tmp_path / "none.toml")


@pytest.mark.parametrize("config", [*(stage.config for stage in STAGES), EvalConfig])
def test_every_number_has_two_bounds(config: type[Config]) -> None:
    for spec in settings_of(config):
        if spec.type in (int, float, tuple[int, ...], tuple[float, ...]):
            assert (spec.ge is not None or spec.gt is not None) and spec.le is not None, spec.name


@pytest.mark.parametrize("stage", [*STAGES], ids=lambda stage: stage.name)
def test_the_values_that_ship_are_in_range(stage) -> None:  # noqa: ANN001
    folder = Path(__file__).parents[2] / "stages"
    load(stage.config, folder / f"{stage.name}.toml")
    load(RawConfig, folder / "raw.toml")
