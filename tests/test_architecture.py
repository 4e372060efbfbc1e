"""The structure that docs/design.md describes, held by reading the imports."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from upvl_cli.pipeline.workspace import NO_STAGES
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
    "datasets": BASE | {"datasets", "geometry", "stage"},
    "vlm": BASE | {"vlm", "parallel"},
    "detector": BASE | {"detector", "geometry", "parallel", "tables"},
    "stages": BASE
    | {"algorithms", "detector", "metrics", "geometry", "stage", "inputs", "rows", "parallel", "stages"},
    "querying": BASE
    | {
        "querying",
        "algorithms",
        "drawing",
        "parallel",
        "rows",
        "settings",
        "stage",
        "stages",
        "tables",
        "vlm",
        "workspace",
    },
    "evaluation": BASE
    | {
        "evaluation",
        "algorithms",
        "datasets",
        "metrics",
        "geometry",
        "stage",
        "stages",
        "settings",
        "tables",
        "workspace",
        "runner",
        "sweep",
    },
}
# Who reads labels, and who may import that: these modules themselves and evaluation.
LABELS = re.compile(
    rf"{PACKAGE}\.datasets\.(label_sources|\w+_labels|\w+_truth|kitti_tracklets|kitti_objects)\b"
)
MAY_OPEN_FILES = {
    "contents",
    "datasets",
    "tables",
    "settings",
    "workspace",
    "runner",
    "status",
    "template",
    "look",
    "sweep",
    "vlm",
}
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


def module(path: Path) -> str:
    """Name by which a file is imported."""
    parts = path.relative_to(SOURCE).with_suffix("").parts
    return ".".join([PACKAGE, *(part for part in parts if part != "__init__")])


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_only_evaluation_knows_labels(path: Path) -> None:
    """No 3D human label can be read outside `upvl eval`: nothing else imports what reads one."""
    if place(path) == "evaluation" or LABELS.fullmatch(module(path)):
        return
    assert not [name for name in imports(path) if LABELS.match(name)]


def test_the_rule_for_labels_names_every_module_that_knows_their_files() -> None:
    readers = {path.stem for path in MODULES if LABELS.fullmatch(module(path))}
    assert {"label_sources", "kitti_labels", "street_labels"} <= readers
    texts = {path.stem: path.read_text() for path in MODULES}
    assert {name for name, text in texts.items() if "tracklet" in text or "object_label" in text} <= readers


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_no_import_escapes_these_rules(path: Path) -> None:
    """All imports are written out: none is relative, and none is computed."""
    tree = ast.walk(ast.parse(path.read_text()))
    assert not [node for node in tree if isinstance(node, ast.ImportFrom) and node.level]
    assert not calls(path) & {
        "import_module",
        "__import__",
        "spec_from_file_location",
        "run_module",
        "run_path",
    }


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_only_the_command_line_evaluates(path: Path) -> None:
    known = [name for name in imports(path) if name.startswith(f"{PACKAGE}.evaluation")]
    if place(path) == "plan":
        assert all(name.startswith(f"{PACKAGE}.evaluation.params") for name in known)
    elif place(path) not in {"cli", "evaluation"}:
        assert not known


@pytest.mark.parametrize("path", MODULES, ids=ids)
def test_files_and_functions_stay_small(path: Path) -> None:
    text = path.read_text()
    assert len(text.splitlines()) <= 350
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            body = (node.end_lineno or 0) - node.body[0].lineno
            assert body <= 60, f"{node.name} has {body} lines"


def test_stages_stand_after_what_they_read() -> None:
    seen = set(NO_STAGES)
    for stage in STAGES:
        assert set(stage.reads) <= seen, stage.name
        seen.add(stage.name)


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_one_name_everywhere(stage) -> None:  # noqa: ANN001
    assert stage.run.__module__ == f"upvl_cli.stages.{stage.name.replace('-', '_')}"
    assert (SOURCE.parents[1] / "stages" / f"{stage.name}.toml").is_file()
