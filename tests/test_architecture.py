"""The structure that docs/design.md describes, held by reading the imports."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from upvl_cli.stages import STAGES

SOURCE = Path(__file__).parents[1] / "src" / "upvl_cli"
MODULES = sorted(SOURCE.rglob("*.py"))
PACKAGE = "upvl_cli"

# Who may know whom: each folder or file, and what it may import of the package.
BASE = {"types", "errors"}
ALLOWED = {
    "geometry": BASE | {"geometry"},
    "algorithms": BASE | {"algorithms", "geometry"},
    "metrics": BASE | {"metrics", "geometry"},
    "drawing": BASE | {"drawing", "geometry"},
    "datasets": BASE | {"datasets", "geometry"},
    "stages": BASE | {"algorithms", "metrics", "geometry", "stage", "inputs", "rows", "stages"},
}
MAY_OPEN_FILES = {"datasets", "tables", "settings", "workspace", "runner", "status", "template", "look"}
MAY_PRINT = {"cli", "progress"}


def imports(path: Path, *, top_only: bool = False) -> Iterator[str]:
    """Modules that a file imports; with `top_only` those that importing it loads."""
    tree = ast.parse(path.read_text())
    for node in tree.body if top_only else ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def place(path: Path) -> str:
    """Folder of a module in the package, or its own name at the top."""
    parts = path.relative_to(SOURCE).with_suffix("").parts
    return parts[0]


def ids(path: Path) -> str:
    return str(path.relative_to(SOURCE))


@pytest.mark.parametrize("path", [p for p in MODULES if place(p) in ALLOWED], ids=ids)
def test_a_module_knows_only_what_it_may(path: Path) -> None:
    known = {name.split(".")[1] for name in imports(path) if name.startswith(f"{PACKAGE}.")}
    assert known <= ALLOWED[place(path)]


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_only_the_command_line_knows_typer(path: Path) -> None:
    if place(path) != "cli":
        assert not [name for name in imports(path) if name.split(".")[0] == "typer"]


@pytest.mark.parametrize("path", [p for p in MODULES if p.parent.name == "stages"], ids=ids)
def test_a_stage_is_light_and_alone(path: Path) -> None:
    if path.name == "__init__.py":
        return
    top = list(imports(path, top_only=True))
    assert {name.split(".")[0] for name in top} <= {
        "__future__",
        "collections",
        "dataclasses",
        "typing",
        PACKAGE,
    }
    assert not [name for name in imports(path) if name.startswith(f"{PACKAGE}.stages")]


def calls(path: Path) -> set[str]:
    """Names of the functions and methods that a file calls."""
    tree = ast.parse(path.read_text())
    called = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    return {
        f.id if isinstance(f, ast.Name) else f.attr
        for f in called
        if isinstance(f, (ast.Name, ast.Attribute))
    }


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_who_prints_opens_and_asserts(path: Path) -> None:
    called = calls(path)
    if place(path) not in MAY_PRINT:
        assert "print" not in called
    if place(path) not in MAY_OPEN_FILES:
        assert not called & {"read_text", "write_text", "read_bytes", "write_bytes", "fromfile", "load_file"}
    assert not called & {"eval", "exec", "pickle", "literal_eval"}


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_nothing_is_unpickled(path: Path) -> None:
    assert not [
        name for name in imports(path) if name.split(".")[0] in {"pickle", "dill", "joblib", "shelve"}
    ]


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_only_evaluation_knows_labels(path: Path) -> None:
    """No 3D human label is read outside `upvl eval`."""
    if place(path) in {"datasets", "evaluation"}:
        return
    assert not [name for name in imports(path) if "labels" in name.split(".")[-2:][0] and "datasets" in name]


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_files_and_functions_stay_small(path: Path) -> None:
    text = path.read_text()
    assert len(text.splitlines()) <= 350
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            body = (node.end_lineno or 0) - node.body[0].lineno
            assert body <= 60, f"{node.name} has {body} lines"


def test_stages_stand_after_what_they_read() -> None:
    seen = {"raw"}
    for stage in STAGES:
        assert set(stage.reads) <= seen, stage.name
        seen.add(stage.name)


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_one_name_everywhere(stage) -> None:  # noqa: ANN001
    assert stage.run.__module__ == f"upvl_cli.stages.{stage.name.replace('-', '_')}"
    assert (SOURCE.parents[1] / "stages" / f"{stage.name}.toml").is_file()
