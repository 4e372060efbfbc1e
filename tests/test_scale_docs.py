"""docs/scale.md and docs/deploy: every command and option is there, and the manifests say what the page says."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from upvl_cli.cli import app

DOCS = Path(__file__).parents[1] / "docs"
JOB = yaml.safe_load((DOCS / "deploy" / "kubernetes-job.yaml").read_text())
RAY = yaml.safe_load((DOCS / "deploy" / "ray-cluster.yaml").read_text())
COMMAND: Any = typer.main.get_command(app)


def lines_of(page: str) -> list[str]:
    """The lines of the code blocks of a page."""
    blocks = re.findall(r"```sh\n(.*?)```", (DOCS / page).read_text(), flags=re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if line.strip()]


def upvl_lines() -> list[str]:
    """The commands of upvl, those in containers and manifests too, from the word upvl on."""
    found = [re.sub(r"^(?:\w+=\S+ )+", "", line) for line in lines_of("scale.md")]
    found = [re.sub(r"^docker run .* upvl:\w+ ", "upvl ", line) for line in found]
    found.append(container()["command"][-1].removeprefix("exec "))
    return [line for line in found if line.startswith("upvl ")]


def container() -> dict[str, Any]:
    return JOB["spec"]["template"]["spec"]["containers"][0]


def options_of(command: Any) -> dict[str, bool]:
    """The options of a command, and whether each takes a value."""
    return {
        name: not option.is_flag
        for option in command.params
        if option.param_type_name == "option"
        for name in (*option.opts, *option.secondary_opts)
    }


@pytest.mark.parametrize("line", upvl_lines())
def test_every_command_and_option_of_the_page_exists(line: str) -> None:
    words = shlex.split(line.replace("$((JOB_COMPLETION_INDEX + 1))", "1"))[1:]
    command, known = COMMAND, options_of(COMMAND)
    while words:
        word = words.pop(0)
        if word.startswith("-"):
            assert word in known, f"{line}: no option {word}"
            if known[word]:
                assert words, f"{line}: {word} without a value"
                words.pop(0)
        elif command is COMMAND:
            assert word in COMMAND.commands, f"{line}: no command {word}"
            command = COMMAND.commands[word]
            known = options_of(command)
        else:
            assert any(p.param_type_name == "argument" for p in command.params), (
                f"{line}: {word} is no option"
            )
    assert command is not COMMAND


def test_the_page_has_every_way_and_few_lines_of_other_tools() -> None:
    text = "\n".join(upvl_lines())
    for way in (
        "--on processes:8",
        "--on slurm --dry-run",
        "--on ray://",
        "--shard",
        "--out s3://",
        "plan --estimate",
    ):
        assert way in text
    others = {line.split()[0] for line in lines_of("scale.md")} - {"upvl", "UPVL_OUT=gs://bucket/run"}
    assert others == {"cd", "pip", "ray", "docker", "printf", "kubectl"}


def test_a_share_of_the_job_is_counted_from_one_and_there_are_as_many_as_pods() -> None:
    spec = JOB["spec"]
    assert spec["completionMode"] == "Indexed"
    assert f"--shard $((JOB_COMPLETION_INDEX + 1))/{spec['completions']}" in container()["command"][-1]
    assert spec["template"]["spec"]["restartPolicy"] == "Never"  # what a limit for each index needs


def test_the_pod_has_no_rights_and_writes_into_volumes_that_are_mounted() -> None:
    pod, inside = JOB["spec"]["template"]["spec"], container()
    user = re.search(r"^USER (\d+):(\d+)$", (DOCS.parent / "Dockerfile").read_text(), flags=re.MULTILINE)
    assert user
    assert (pod["securityContext"]["runAsUser"], pod["securityContext"]["runAsGroup"]) == tuple(
        map(int, user.groups())
    )
    assert pod["securityContext"]["runAsNonRoot"]
    assert inside["securityContext"]["readOnlyRootFilesystem"]
    assert not inside["securityContext"]["allowPrivilegeEscalation"]
    mounted = {mount["name"]: mount["mountPath"] for mount in inside["volumeMounts"]}
    assert set(mounted) == {volume["name"] for volume in pod["volumes"]}
    variables = {entry["name"]: entry["value"] for entry in inside["env"]}
    assert variables["UPVL_CACHE"] == mounted["cache"]
    assert variables["UPVL_THREADS"] == inside["resources"]["requests"]["cpu"]
    sizes = {
        volume["name"]: int(volume["emptyDir"]["sizeLimit"].removesuffix("Gi")) for volume in pod["volumes"]
    }
    assert float(variables["UPVL_CACHE_GB"]) < sizes["cache"]
    assert sum(sizes.values()) <= int(inside["resources"]["limits"]["ephemeral-storage"].removesuffix("Gi"))


def test_the_ray_cluster_has_the_nodes_that_it_names() -> None:
    assert RAY["head_node_type"] in RAY["available_node_types"]
    assert RAY["available_node_types"]["head"]["resources"]["CPU"] == 0
    assert RAY["max_workers"] == RAY["available_node_types"]["cpu"]["max_workers"]
    port = re.search(r"--ray-client-server-port=(\d+)", " ".join(RAY["head_start_ray_commands"]))
    assert port
    assert f"ray://127.0.0.1:{port.group(1)}" in "\n".join(upvl_lines())


def test_no_manifest_holds_a_secret() -> None:
    for path in (DOCS / "deploy").iterdir():
        assert not re.search(r"(?i)(secret_access_key|password|token)\s*[:=]\s*\S", path.read_text()), (
            path.name
        )
