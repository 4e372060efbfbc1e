"""The structure that docs/design.md describes, held by reading the imports."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from upvl_cli.pipeline.stage import NOT_MADE
from upvl_cli.stages import LABELLING, STAGES

SOURCE = Path(__file__).parents[1] / "src" / "upvl_cli"
MODULES = sorted(SOURCE.rglob("*.py"))
PACKAGE = "upvl_cli"

# Which rooms each room may import, every module of the package included; the root's own modules by their names.
BASE = {"types", "errors"}
METHOD = BASE | {"config", "runtime", "geometry"}
USE_CASES = METHOD | {"pipeline", "stages", "perception", "metrics", "drawing", "vlm"}
ALLOWED = {
    "errors": set(),
    "types": {"errors"},
    "runtime": {"errors"},
    "config": {"errors", "config"},
    "geometry": BASE | {"geometry"},
    "perception": METHOD | {"perception"},
    "metrics": METHOD | {"metrics"},
    "drawing": METHOD | {"drawing"},
    "detector": METHOD | {"detector"},
    "vlm": METHOD | {"vlm"},
    "boxes2d": METHOD | {"boxes2d", "datasets"},
    "synthetic": METHOD | {"synthetic", "datasets"},
    "datasets": METHOD | {"datasets", "synthetic"},
    "pipeline": BASE | {"config", "runtime", "pipeline"},
    "stages": METHOD | {"pipeline", "stages", "perception", "detector", "boxes2d"},
    "query": USE_CASES | {"query"},
    "evaluation": USE_CASES | {"evaluation", "datasets", "export"},
    "commands": USE_CASES | {"commands", "datasets", "synthetic"},
    "export": METHOD | {"pipeline", "stages", "datasets", "query", "export"},
    "viewer": USE_CASES | {"viewer"},
    "report": USE_CASES | {"report", "commands"},
    "results": USE_CASES | {"results", "query", "viewer", "commands"},
    "web": USE_CASES | {"web", "query", "export", "viewer"},
    "cli": USE_CASES
    | {
        "cli",
        "commands",
        "query",
        "evaluation",
        "detector",
        "synthetic",
        "export",
        "viewer",
        "report",
        "web",
    },
    "__main__": {"cli"},
    "__init__": {"results"},
}
# Of the made-up city others see its dataset, its labels and its settings, and its own command sees all.
CITY_DOORS = {
    "datasets.registry": {"synthetic.config", "synthetic.dataset"},
    "datasets.label_registry": {"synthetic.labels"},
    "cli.labels": {"synthetic.config"},
    "cli.draw": {"synthetic.kinds"},
    "commands.synth_preview": {"synthetic.cameras", "synthetic.dataset"},
}
# Who reads labels, and who may import that: these modules themselves and evaluation.
LABELS = re.compile(
    rf"{PACKAGE}\.(datasets\.(label_registry|exact_labels|flow_truth|\w+\.(labels|tracklets|objects|annotations))|synthetic\.labels)\b"
)
MAY_OPEN_FILES = {
    "config", "datasets", "pipeline", "runtime", "vlm", "boxes2d", "synthetic", "detector", "commands", "export",
    "report", "results", "viewer", "web",
}  # fmt: skip
MAY_PRINT = {"cli"}
MOST_PARAMETERS = 8


@cache
def tree(path: Path) -> ast.Module:
    """Syntax tree of a file."""
    return ast.parse(path.read_text())


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """All nodes of the syntax tree of a file."""
    return tuple(ast.walk(tree(path)))


def imports(path: Path, *, top_only: bool = False) -> Iterator[str]:
    """Modules that a file imports; with `top_only` those that importing it loads."""
    for node in tree(path).body if top_only else nodes(path):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def place(path: Path) -> str:
    """Folder of a module in the package, or its own name at the top."""
    parts = path.relative_to(SOURCE).with_suffix("").parts
    return parts[0]


def offenders(found: dict[Path, object]) -> dict[str, object]:
    """The files against a rule, by their names in the package, and what each has against it."""
    return {str(path.relative_to(SOURCE)): what for path, what in found.items() if what}


def test_the_root_has_few_modules() -> None:
    assert {path.stem for path in MODULES if path.parent == SOURCE} == {
        "__init__",
        "__main__",
        "types",
        "errors",
    }


def test_every_room_has_a_rule() -> None:
    assert {place(path) for path in MODULES} == set(ALLOWED)


def test_a_module_knows_only_what_it_may() -> None:
    def too_much(path: Path) -> set[str]:
        known = {name.split(".")[1] for name in imports(path) if name.startswith(f"{PACKAGE}.")}
        return known - ALLOWED[place(path)]

    assert not offenders({path: too_much(path) for path in MODULES})


def test_boxes2d_knows_of_datasets_how_tables_are_read_alone() -> None:
    inside = {name for path in MODULES if place(path) == "boxes2d" for name in modules_of(path)}
    assert {name for name in inside if name.startswith(f"{PACKAGE}.datasets")} <= {
        f"{PACKAGE}.datasets.shared.arrow"
    }


def test_the_city_has_few_doors() -> None:
    def other_doors(path: Path) -> set[str]:
        inside = {name for name in modules_of(path) if name.startswith(f"{PACKAGE}.synthetic")}
        doors = CITY_DOORS.get(module(path).removeprefix(f"{PACKAGE}."), set())
        return inside - {f"{PACKAGE}.{door}" for door in doors}

    assert not offenders({path: other_doors(path) for path in MODULES if place(path) != "synthetic"})


@cache
def modules_of(path: Path) -> set[str]:
    """Modules of the package that a file imports, wherever in the file and for type checking too."""
    known = {module(other) for other in MODULES}
    found = set()
    for name in imports(path):
        for candidate in (name, name.rpartition(".")[0]):
            if candidate in known and candidate != PACKAGE:
                found.add(candidate)
                break
    return found


def test_no_module_imports_itself_through_others() -> None:
    """No circle of any kind, those that only type checking sees included."""
    graph = {module(path): modules_of(path) - {module(path)} for path in MODULES}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


def test_every_class_has_a_name_of_its_own() -> None:
    names = Counter(
        node.name for path in MODULES for node in tree(path).body if isinstance(node, ast.ClassDef)
    )
    assert not [name for name, count in names.items() if count > 1]


def functions(path: Path) -> list[ast.FunctionDef]:
    """All functions and methods of a file."""
    return [node for node in nodes(path) if isinstance(node, ast.FunctionDef)]


def test_functions_have_few_parameters() -> None:
    def parameters(node: ast.FunctionDef) -> int:
        arguments = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
        return len([argument for argument in arguments if argument.arg not in ("self", "cls")])

    outside = [path for path in MODULES if place(path) != "cli"]
    assert not offenders(
        {
            path: {node.name for node in functions(path) if parameters(node) > MOST_PARAMETERS}
            for path in outside
        }
    )


def test_only_the_command_line_knows_typer() -> None:
    outside = [path for path in MODULES if place(path) != "cli"]
    assert not offenders(
        {path: [name for name in imports(path) if name.split(".")[0] == "typer"] for path in outside}
    )


def test_a_stage_is_light_and_alone() -> None:
    light = {"__future__", "collections", "dataclasses", "typing", PACKAGE}
    shared = tuple(
        f"{PACKAGE}.stages.{name}"
        for name in ("rows", "picture_rows", "shared_columns", "track_sightings", "correction_rows")
    )

    def heavy_or_other(path: Path) -> set[str]:
        heavy = {name for name in imports(path, top_only=True) if name.split(".")[0] not in light}
        others = {name for name in imports(path) if name.startswith(f"{PACKAGE}.stages")}
        return heavy | {name for name in others if not name.startswith(shared)}

    stages = [path for path in MODULES if path.parent.name == "stages" and path.name != "__init__.py"]
    assert len(stages) > len(STAGES)
    assert not offenders({path: heavy_or_other(path) for path in stages})


@cache
def calls(path: Path) -> set[str]:
    """Names of the functions and methods that a file calls."""
    called = [node.func for node in nodes(path) if isinstance(node, ast.Call)]
    return {
        f.id if isinstance(f, ast.Name) else f.attr
        for f in called
        if isinstance(f, (ast.Name, ast.Attribute))
    }


def test_who_prints_opens_and_evaluates() -> None:
    opening = {"read_text", "write_text", "read_bytes", "write_bytes", "fromfile", "load_file"}

    def forbidden(path: Path) -> set[str]:
        return (
            {"eval", "exec", "pickle", "literal_eval"}
            | (set() if place(path) in MAY_PRINT else {"print"})
            | (set() if place(path) in MAY_OPEN_FILES else opening)
        )

    assert not offenders({path: calls(path) & forbidden(path) for path in MODULES})


def test_nothing_is_unpickled() -> None:
    picklers = {"pickle", "dill", "joblib", "shelve"}
    assert not offenders(
        {path: {name for name in imports(path) if name.split(".")[0] in picklers} for path in MODULES}
    )


@cache
def module(path: Path) -> str:
    """Name by which a file is imported."""
    parts = path.relative_to(SOURCE).with_suffix("").parts
    return ".".join([PACKAGE, *(part for part in parts if part != "__init__")])


def test_only_evaluation_knows_labels() -> None:
    """No 3D human label can be read outside `upvl eval`: nothing else imports what reads one."""
    others = [path for path in MODULES if place(path) != "evaluation" and not LABELS.fullmatch(module(path))]
    assert not offenders({path: [name for name in imports(path) if LABELS.match(name)] for path in others})


def test_the_rule_for_labels_names_every_module_that_knows_their_files() -> None:
    readers = {path.stem for path in MODULES if LABELS.fullmatch(module(path))}
    assert {"label_registry", "labels", "tracklets", "objects"} <= readers
    # Not the formats of `export`: what they write and read is what users take and correct, by its path alone.
    texts = {path.stem: path.read_text() for path in MODULES if place(path) != "export"}
    assert {name for name, text in texts.items() if "tracklet" in text or "object_label" in text} <= readers


def test_no_import_escapes_these_rules() -> None:
    """All imports are written out: none is relative, and none is computed."""
    computing = {"import_module", "__import__", "spec_from_file_location", "run_module", "run_path"}

    def escapes(path: Path) -> set[str]:
        relative = [node for node in nodes(path) if isinstance(node, ast.ImportFrom) and node.level]
        return calls(path) & computing | {f"line {node.lineno}" for node in relative}

    assert not offenders({path: escapes(path) for path in MODULES})


def test_only_the_command_line_evaluates() -> None:
    others = [path for path in MODULES if place(path) not in {"cli", "evaluation"}]
    assert not offenders(
        {
            path: [name for name in imports(path) if name.startswith(f"{PACKAGE}.evaluation")]
            for path in others
        }
    )


def test_files_and_functions_stay_small() -> None:
    def long_functions(path: Path) -> set[str]:
        return {node.name for node in functions(path) if (node.end_lineno or 0) - node.body[0].lineno > 60}

    assert not offenders({path: long_functions(path) for path in MODULES})
    lines = {path: len(path.read_text().splitlines()) for path in MODULES}
    assert not offenders({path: count for path, count in lines.items() if count > 350})


def test_stages_stand_after_what_they_read() -> None:
    seen = set(NOT_MADE)
    for stage in STAGES:
        assert set(stage.reads) <= seen, stage.name
        seen.add(stage.name)


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_one_name_everywhere(stage) -> None:  # noqa: ANN001
    assert stage.run.__module__ == f"upvl_cli.stages.{stage.name.replace('-', '_')}"
    assert (SOURCE.parents[1] / "stages" / f"{stage.name}.toml").is_file()


def test_labelling_stages_stand_before_those_that_learn_from_labels() -> None:
    assert [stage.name for stage in STAGES][: len(LABELLING)] == list(LABELLING)
