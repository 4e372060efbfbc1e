"""Values are checked against their declarations, and every fault is named."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from upvl_cli.config.toml import load
from upvl_cli.errors import BadSetting
from upvl_cli.evaluation.config import EvalConfig
from upvl_cli.pipeline.stage import param, params_of
from upvl_cli.pipeline.workspace import RawConfig
from upvl_cli.stages import STAGES


@dataclass(frozen=True)
class Settings:
    speed_mps: float = param("a speed", "m/s", above=0, most=80)
    points: int = param("a number of points", least=3)
    method: str = param("how", choices=("fast", "slow"))
    names: tuple[str, ...] = param("some names")


GOOD = 'speed_mps = 4\npoints = 5\nmethod = "fast"\nnames = ["a"]\n'


def written(folder: Path, text: str) -> Path:
    path = folder / "it.toml"
    path.write_text(text)
    return path


def test_values_come_in_their_declared_types(tmp_path: Path) -> None:
    assert load(Settings, written(tmp_path, GOOD)) == Settings(4.0, 5, "fast", ("a",))


def test_values_of_the_command_line_win(tmp_path: Path) -> None:
    assert load(Settings, written(tmp_path, GOOD), {"points": 7}).points == 7


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("points = 5", "ponts = 5", "unknown key 'ponts'; did you mean 'points'? (known: speed_mps, points,"),
        ("points = 5", "", "missing key 'points' (a number of points)"),
        ("speed_mps = 4", "speed_mps = 0", "speed_mps = 0.0 must be > 0 and <= 80 m/s (a speed)"),
        ("speed_mps = 4", "speed_mps = nan", "speed_mps = nan must be > 0"),
        ("speed_mps = 4", 'speed_mps = "4"', "speed_mps = '4' must be a number"),
        ("speed_mps = 4", "speed_mps = true", "speed_mps = True must be a number"),
        ("points = 5", "points = 5.5", "points = 5.5 must be a whole number"),
        ("points = 5", "points = 2", "points = 2 must be >= 3 (a number of points)"),
        ('"fast"', '"quick"', "method = 'quick' must be one of fast, slow (how)"),
        ('["a"]', '"a"', "names = 'a' must be a list of a text"),
        ('["a"]', "[1]", "names[0] = 1 must be a text"),
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


@pytest.mark.parametrize("params", [*(stage.params for stage in STAGES), EvalConfig])
def test_every_number_has_two_bounds(params: type[Any]) -> None:
    for name, (kind, spec) in params_of(params).items():
        if kind in (int, float, tuple[int, ...], tuple[float, ...]):
            assert spec.least is not None and spec.most is not None, name


@pytest.mark.parametrize("stage", [*STAGES], ids=lambda stage: stage.name)
def test_the_values_that_ship_are_in_range(stage) -> None:  # noqa: ANN001
    folder = Path(__file__).parents[2] / "stages"
    load(stage.params, folder / f"{stage.name}.toml")
    load(RawConfig, folder / "raw.toml")
