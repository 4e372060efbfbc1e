"""What is declared about the package: that the wheel holds all a workspace needs, and which terms it is under.

`.ci/wheel` builds and installs the wheel for real; these tests say in milliseconds what would break it.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

from upvl_cli.commands import init

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = PYPROJECT["project"]


def test_wheel_holds_every_file_that_init_copies(tmp_path: Path, monkeypatch) -> None:
    forced = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    for source, target in forced.items():
        (tmp_path / target).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / target).symlink_to(ROOT / source)
    # As installed: the package with what the wheel forces into it, and no checkout around.
    monkeypatch.setattr(init, "__file__", str(tmp_path / "upvl_cli" / "commands" / "init.py"))
    init.create(tmp_path / "drives")
    assert (tmp_path / "drives" / "Makefile").read_text() == (ROOT / "workspace.mk").read_text()
    made = {path.relative_to(tmp_path / "drives") for path in (tmp_path / "drives").rglob("*.toml")}
    assert made == {path.relative_to(ROOT) for path in (ROOT / "stages").rglob("*.toml")}


def test_licence_names_the_terms_of_the_weights_and_ships_their_text() -> None:
    names = re.findall(r"LicenseRef-[\w-]+", PROJECT["license"])
    assert names == ["LicenseRef-upvl-research-weights"]
    shipped = {path for pattern in PROJECT["license-files"] for path in ROOT.glob(pattern)}
    assert shipped == {ROOT / "LICENSE", *(ROOT / "LICENSES").iterdir()}
    text = (ROOT / "LICENSES" / f"{names[0]}.txt").read_text()
    weights = {path.name for path in (ROOT / "src/upvl_cli/vlm/weights").iterdir()}
    assert all(name in text for name in weights), f"terms of some of {weights} are not stated"


def test_every_requirement_has_a_pinned_version() -> None:
    extras = PROJECT["optional-dependencies"]
    # Not openseg: tensorflow is on no machine that runs the tests.
    chosen = [spec for name, specs in extras.items() if name != "openseg" for spec in specs]
    required = [*PROJECT["dependencies"], *PYPROJECT["build-system"]["requires"], *chosen]
    pinned = {
        _normal(line.partition("==")[0]) for line in (ROOT / "constraints.txt").read_text().splitlines()
    }
    names = {_normal(re.split(r"[\[><=; ]", spec)[0]) for spec in required} - {"upvl"}
    assert names <= pinned, f"constraints.txt does not pin {sorted(names - pinned)}"


def test_version_is_printed_without_a_workspace_and_without_heavy_imports(tmp_path: Path) -> None:
    program = (
        "import sys; from upvl_cli.cli import run; code = run(['--version']);"
        "print(sorted({'numpy', 'torch', 'pyarrow', 'scipy', 'pydantic'} & set(sys.modules))); sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"upvl {PROJECT['version']}\n[]\n"


def test_links_of_the_pages_lead_somewhere() -> None:
    pages = [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]
    for page in pages:
        for target in re.findall(r"\]\(([^)#\s]+)", page.read_text(encoding="utf-8")):
            if "://" not in target:
                assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_a_link_named_by_a_function_leads_to_the_file_that_defines_it() -> None:
    text = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    links = re.findall(r"\[`(\w+)`\]\(\.\./([^)]+\.py)\)", text)
    assert len(links) > 10
    for name, target in links:
        code = (ROOT / target).read_text(encoding="utf-8")
        assert re.search(rf"^(def|class) {name}\b", code, flags=re.MULTILINE), f"{target} defines no {name}"


def _normal(name: str) -> str:
    return name.strip().lower().replace("_", "-")
