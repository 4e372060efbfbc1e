"""Measure how surely the tests hold the method: python bench/mutation.py [--sample 120] [--seed 0] [--workers 2].

Draw a random sample of small faults (mutants) in the algorithms: a swapped comparison, sign or operator, a constant
plus one, `and` for `or`, `min` for `max`, a term left out. Put each into a copy of the repository, run the fast tests
that execute the changed line there, and count how many faults a test finds. A fault on a line that no fast test of the
mirrored test folder executes survives at once. With --full each survivor is tried again on all fast tests. Print the
share of faults found and every survivor; some survivors compute the same as the original and need no test.

The working tree is never changed. The tool that proposes the faults is mutmut, the one that says which test executes a
line is coverage; both come with the extra `dev`.
"""

from __future__ import annotations

import argparse
import os
import queue
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import libcst as cst
from coverage import CoverageData
from libcst.metadata import MetadataWrapper, PositionProvider
from mutmut.mutation import mutators
from mutmut.mutation.file_mutation import MutationVisitor
from mutmut.mutation.pragma_handling import IgnoredCode

ROOT = Path(__file__).parents[1]
PACKAGE = Path("src/upvl_cli")
ROOMS = ("perception", "detector", "query")
# Of the detector only what computes targets, losses and boxes; the rest is training, files and processes.
DETECTOR = re.compile(r"targets|assign|loss|decode|coder|predict|head|anchor|cent(er|re)s")
FAST = ("-m", "not slow", "-p", "no:cacheprovider", "-q")
IMPORT = ""  # the coverage context of what runs while modules are imported
ALL_PASSED, SOME_FAILED, INTERRUPTED = (
    0,
    1,
    2,
)  # pytest's exit codes; a module that cannot be imported interrupts
EXTREMA = {"min": "max", "argmin": "argmax", "minimum": "maximum", "any": "all", "floor": "ceil"}
EXTREMA |= {after: before for before, after in EXTREMA.items()}

# Counts the lines that each test file executes; runs inside pytest, in a process of its own.
PLUGIN = """
import coverage, pytest

@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item):
    coverage.Coverage.current().switch_context(item.nodeid.partition("::")[0])
    yield
"""


@dataclass(frozen=True)
class Mutant:
    """One fault.

    Attributes:
        path: File, from the root of the repository.
        line: Number of the first changed line.
        before: Text of the changed lines.
        after: Text of the lines in their place.
        code: The whole file with the fault.
    """

    path: Path
    line: int
    before: str
    after: str
    code: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.before}  ->  {self.after}"


def swap_extremum(node: cst.Name) -> Iterator[cst.Name]:
    """Yield the opposite extremum, quantifier or rounding: `argmin` for `argmax`."""
    if node.value in EXTREMA:
        yield node.with_changes(value=EXTREMA[node.value])


def drop_term(node: cst.BinaryOperation) -> Iterator[cst.BaseExpression]:
    """Yield a sum or a set of conditions without its last term."""
    if isinstance(node.operator, cst.Add | cst.Subtract | cst.BitAnd | cst.BitOr):
        yield node.left


# Faults that an author could make. Not used are mutmut's `None` for a value and its changed texts: they raise an error
# at once, whatever is tested, and would make the share look better than it is.
OPERATORS = [
    (cst.BaseNumber, mutators.operator_number),
    (cst.Name, mutators.operator_name),
    (cst.UnaryOperation, mutators.operator_remove_unary_ops),
    (cst.CSTNode, mutators.operator_keywords),
    (cst.CSTNode, mutators.operator_swap_op),
    (cst.IfExp, mutators.operator_if_exp),
    (cst.Name, swap_extremum),
    (cst.BinaryOperation, drop_term),
]


def sources() -> list[Path]:
    """Return the files that are mutated, from the root of the repository."""
    paths = [path for room in ROOMS for path in sorted((ROOT / PACKAGE / room).rglob("*.py"))]
    found = [path.relative_to(ROOT) for path in paths if path.name not in ("__init__.py", "config.py")]
    return [
        path
        for path in found
        if "detector" not in path.parts or DETECTOR.search(str(path.relative_to(PACKAGE)))
    ]


class Source:
    """One file and the places where a fault can be put into it."""

    def __init__(self, path: Path) -> None:
        """Parse the file; no fault is made yet, because most are never drawn."""
        self.path = path
        self._code = (ROOT / path).read_text(encoding="utf-8")
        wrapper = MetadataWrapper(cst.parse_module(self._code))
        visitor = MutationVisitor(OPERATORS, IgnoredCode(set(), set(), set()))
        wrapper.visit(visitor)
        self._module = wrapper.module
        self._positions = wrapper.resolve(PositionProvider)
        lines = self._code.splitlines()
        # Not decorators: frozen=True and the like are no part of the method.
        self._mutations = [
            mutation
            for mutation in visitor.mutations
            if not lines[self._positions[mutation.original_node].start.line - 1].lstrip().startswith("@")
        ]

    def __len__(self) -> int:
        return len(self._mutations)

    def mutant(self, index: int) -> Mutant:
        """Return one fault."""
        mutation = self._mutations[index]
        span = self._positions[mutation.original_node]
        lines = self._code.splitlines()
        code = self._module.deep_replace(mutation.original_node, mutation.mutated_node).code
        end = span.end.line + len(code.splitlines()) - len(lines)
        before, after = (
            lines[span.start.line - 1 : span.end.line],
            code.splitlines()[span.start.line - 1 : end],
        )
        return Mutant(self.path, span.start.line, _words(before), _words(after), code)


def _words(lines: Iterable[str]) -> str:
    return " ".join(" ".join(lines).split())


class Copy:
    """A copy of the repository with a Python environment of its own, in which faults are tried one at a time."""

    def __init__(self, folder: Path) -> None:
        """Copy the files that git knows or would add; packages are taken from the running environment."""
        self.folder = folder
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            cwd=ROOT, capture_output=True, text=True, check=True,
        ).stdout  # fmt: skip
        for name in filter(None, listed.split("\0")):
            if (ROOT / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / name, folder / name)
        # Tests run `upvl` from the folder of their Python, so the copy needs both: else they would run the original.
        venv.create(folder / ".venv", symlinks=True, with_pip=False)
        self.python = folder / ".venv" / "bin" / "python"
        version = f"python{sys.version_info.major}.{sys.version_info.minor}"
        packages = [path for path in sys.path if path.endswith("site-packages")]
        site = folder / ".venv" / "lib" / version / "site-packages"
        (site / "copy.pth").write_text("\n".join([str(folder / "src"), *packages]) + "\n")
        command = self.python.with_name("upvl")
        command.write_text(f'#!/bin/sh\nexec {self.python} -m upvl_cli "$@"\n')
        command.chmod(0o755)
        self._writes = 0

    def run(self, *arguments: str, timeout: float | None = None) -> subprocess.CompletedProcess[str]:
        """Run Python in the copy; raises TimeoutExpired."""
        environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1"}
        environment.pop("PYTHONPATH", None)
        return subprocess.run(
            [self.python, *arguments],
            cwd=self.folder, env=environment, capture_output=True, text=True, timeout=timeout,
        )  # fmt: skip

    def write(self, path: Path, code: str) -> None:
        """Put code into a file of the copy; each time looks newer, so that no compiled file is taken for it."""
        self._writes += 1
        (self.folder / path).write_text(code, encoding="utf-8")
        os.utime(self.folder / path, (time.time() + self._writes,) * 2)

    def finds(self, mutant: Mutant, tests: Iterable[str], timeout: float) -> bool:
        """Return whether one of the tests fails, or hangs, with the fault."""
        original = (ROOT / mutant.path).read_text(encoding="utf-8")
        self.write(mutant.path, mutant.code)
        try:
            code = self.run("-m", "pytest", "-x", *FAST, *tests, timeout=timeout).returncode
        except subprocess.TimeoutExpired:
            return True
        finally:
            self.write(mutant.path, original)
        if code not in (ALL_PASSED, SOME_FAILED, INTERRUPTED):
            raise SystemExit(f"pytest ended with {code} on {mutant}: its tests cannot be run")
        return code != ALL_PASSED


def executed_lines(copy: Copy, room: str) -> dict[Path, dict[int, list[str]]]:
    """Return, for each file and line of a room, the test files of the mirrored folder that execute it.

    Raises:
        SystemExit: A test fails without any fault.
    """
    (copy.folder / "line_contexts.py").write_text(PLUGIN)
    settings = f"[run]\nsource = {PACKAGE / room}\ndata_file = .coverage.{room}\nrelative_files = true\n"
    (copy.folder / "coverage.ini").write_text(settings)
    done = copy.run(
        "-m", "coverage", "run", "--rcfile", "coverage.ini", "-m", "pytest",
        "-p", "line_contexts", *FAST, f"tests/{room}",
    )  # fmt: skip
    if done.returncode != ALL_PASSED:
        raise SystemExit(f"tests/{room} fail without any fault:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    data = CoverageData(str(copy.folder / f".coverage.{room}"))
    data.read()
    return {Path(name): data.contexts_by_lineno(name) for name in data.measured_files()}


def tests_of(mutant: Mutant, executed: dict[Path, dict[int, list[str]]]) -> list[str]:
    """Return the test files that execute the changed line.

    A line that is run at import, such as a constant, is tested by all that executes the file.
    """
    lines = executed.get(mutant.path, {})
    here = set(lines.get(mutant.line, ()))
    if here == {IMPORT}:
        here = {test for tests in lines.values() for test in tests}
    return sorted(here - {IMPORT})


def main() -> None:
    """Draw the sample, try each fault, print the share that is found and the rest."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--sample", type=int, default=120, help="number of faults")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sample")
    parser.add_argument("--workers", type=int, default=2, help="faults that are tried at the same time")
    parser.add_argument("--timeout", type=float, default=180.0, help="seconds until a fault counts as found")
    parser.add_argument(
        "--only", default="", help="mutate only files whose path contains this text, as perception/flow"
    )
    parser.add_argument("--full", action="store_true", help="try each survivor on all fast tests")
    chosen = parser.parse_args()
    files = [path for path in sources() if chosen.only in str(path)]
    places = [(source, index) for source in map(Source, files) for index in range(len(source))]
    if not places:
        raise SystemExit(f"no file of {', '.join(ROOMS)} has {chosen.only!r} in its path")
    sample = random.Random(chosen.seed).sample(places, min(chosen.sample, len(places)))
    drawn = [source.mutant(index) for source, index in sample]
    print(f"{len(drawn)} of {len(places)} faults in {len(files)} files, seed {chosen.seed}", flush=True)
    with tempfile.TemporaryDirectory(prefix="mutation-") as folder:
        report(chosen, drawn, [Copy(Path(folder, str(worker))) for worker in range(chosen.workers)])


def report(chosen: argparse.Namespace, drawn: list[Mutant], copies: list[Copy]) -> None:
    """Try the faults in the copies and print what became of each."""
    rooms = sorted({mutant.path.relative_to(PACKAGE).parts[0] for mutant in drawn})
    executed: dict[Path, dict[int, list[str]]] = {}
    for room in rooms:
        executed |= executed_lines(copies[0], room)
    free: queue.SimpleQueue[Copy] = queue.SimpleQueue()
    for copy in copies:
        free.put(copy)

    def attempt(mutant: Mutant) -> str:
        tests, copy = tests_of(mutant, executed), free.get()
        try:
            if tests and copy.finds(mutant, tests, chosen.timeout):
                return ""
            if chosen.full and copy.finds(mutant, ["tests"], 10 * chosen.timeout):
                return ""
        finally:
            free.put(copy)
        return "survives" if tests else "no fast test executes the line"

    started, survivors = time.monotonic(), []
    with ThreadPoolExecutor(len(copies)) as pool:
        for mutant, outcome in zip(drawn, pool.map(attempt, drawn), strict=True):
            if outcome:
                survivors.append(mutant)
            print(f"{outcome or 'found'}: {mutant}", flush=True)
    found = len(drawn) - len(survivors)
    print(
        f"\n{found} of {len(drawn)} faults found ({found / len(drawn):.1%}), {time.monotonic() - started:.0f} s"
    )
    for mutant in sorted(survivors, key=lambda each: (each.path, each.line)):
        print(f"survivor: {mutant}")


if __name__ == "__main__":
    main()
