"""The container images, as far as they can be checked without building them; `.ci/image` builds and runs them."""

from __future__ import annotations

import fnmatch
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
DOCKERFILE = (ROOT / "Dockerfile").read_text()
TARGETS = ("cpu", "cuda")


def instructions(text: str = DOCKERFILE) -> list[tuple[str, str]]:
    """The instructions of the file, each with its words on one line."""
    joined = re.sub(r"\\\n\s*", "", re.sub(r"^#.*\n", "", text, flags=re.MULTILINE))
    return [tuple(line.split(maxsplit=1)) for line in joined.splitlines() if line.strip()]  # type: ignore[misc]


def stage(name: str) -> list[tuple[str, str]]:
    """The instructions of one stage, those of the stage that it starts from before its own."""
    found: list[tuple[str, str]] = []
    inside, base = False, ""
    for word, rest in instructions():
        if word == "FROM":
            image, _, label = rest.partition(" AS ")
            inside, base = label == name, image if label == name else base
        elif inside:
            found.append((word, rest))
    known = {rest.partition(" AS ")[2] for word, rest in instructions() if word == "FROM"}
    return (stage(base) if base in known else []) + found


def ignored(path: str) -> bool:
    """Whether the builder never sees a file: everything but what .dockerignore lets in."""
    allowed = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    return not any(fnmatch.fnmatch(path, name) or path.startswith(f"{name}/") for name in allowed)


def test_every_file_that_is_copied_exists_and_reaches_the_builder() -> None:
    copied = [name for word, rest in instructions() if word == "COPY" for name in rest.split()[:-1]]
    mounted = re.findall(r"type=bind,source=([^,\s]+)", DOCKERFILE)
    assert {"src", "stages", "pyproject.toml"} <= set(copied)
    for name in (*copied, *mounted):
        assert (ROOT / name).exists(), name
        assert not ignored(name), name
    # What Git does not hold is no part of an image: data, results, environments.
    for name in ("out", ".venv", ".git", "tests", "docs", "shared"):
        assert ignored(name)


def test_the_wheel_can_be_built_from_what_is_copied() -> None:
    copied = {name for word, rest in stage("wheel") if word == "COPY" for name in rest.split()[:-1]}
    project, wheel = PYPROJECT["project"], PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = {project["readme"], *wheel["force-include"], *wheel["packages"]}
    needed |= {pattern.partition("/")[0] for pattern in project["license-files"]}
    assert {name.partition("/")[0] for name in needed} <= copied


@pytest.mark.parametrize("target", TARGETS)
def test_a_target_has_no_rights_and_starts_upvl(target: str) -> None:
    found = stage(target)
    users = [rest for word, rest in found if word == "USER"]
    assert users == ["10001:10001"]  # numbers: Kubernetes checks runAsNonRoot by them
    assert ("ENTRYPOINT", '["upvl"]') in found
    assert ("VOLUME", '["/work"]') in found
    assert [word for word, _ in found].index("USER") > [word for word, _ in found].index("RUN")


@pytest.mark.parametrize("target", TARGETS)
def test_a_target_installs_pinned_packages_and_extras_that_exist(target: str) -> None:
    values = dict(rest.split("=", 1) for word, rest in stage(target) if word == "ARG")
    assert set(values["EXTRAS"].split(",")) <= set(PYPROJECT["project"]["optional-dependencies"])
    installs = [
        part
        for word, rest in stage(target)
        if word == "RUN"
        for part in rest.split("&&")
        if "install" in part
    ]
    assert len(installs) == 2
    assert all("--constraint /constraints.txt" in part and "--no-cache-dir" in part for part in installs)
    assert values["TORCH_INDEX"] in ("https://download.pytorch.org/whl/cpu", "https://pypi.org/simple")


def test_python_is_one_that_the_package_allows() -> None:
    version = dict(rest.split("=", 1) for word, rest in instructions() if word == "ARG")["PYTHON"]
    lowest = PYPROJECT["project"]["requires-python"].removeprefix(">=")
    assert tuple(map(int, version.split("."))) >= tuple(map(int, lowest.split(".")))


def test_nothing_is_written_outside_of_the_volumes() -> None:
    caches = re.findall(r"(?:XDG_\w+|MPLCONFIGDIR|UPVL_CACHE)=(\S+)", DOCKERFILE)
    assert len(caches) == 4
    assert all(folder.startswith("/tmp/") for folder in caches)


def test_no_image_is_taken_by_a_moving_name_and_nothing_is_fetched_by_hand() -> None:
    assert ":latest" not in DOCKERFILE
    assert not {word for word, _ in instructions()} & {"ADD", "MAINTAINER", "HEALTHCHECK"}
    assert not re.search(r"\b(curl|wget|sudo)\b", DOCKERFILE)


def test_the_script_that_builds_the_images_is_well_formed() -> None:
    assert subprocess.run(["bash", "-n", ROOT / ".ci" / "image"], check=False).returncode == 0
