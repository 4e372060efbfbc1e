"""Checkpoints of the transformers library: the files that make one, and its towers.

Only safetensors are read, and no code that lies beside them: a checkpoint is data, never a program.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from upvl_cli.errors import BadInput, BadSetting, one_line

WEIGHTS = "*.safetensors"
PREPROCESSOR = "preprocessor_config.json"
# A tokenizer is one of these, with whatever lies beside it.
TOKENIZERS = ("tokenizer.json", "vocab.json", "spiece.model", "tokenizer.model")
BESIDE = ("merges.txt", "tokenizer_config.json", "special_tokens_map.json", "added_tokens.json")
HUB_NAME = re.compile(r"[\w.-]+/[\w.-]+")
HUB_PATTERNS = ["*.safetensors", "*.json", "*.txt", "*.model"]


def folder(weights: str, where: str) -> Path:
    """Return the folder of a checkpoint: on this machine, or fetched from the Hugging Face hub if it is not there yet.

    Args:
        weights: Path of a folder, or a name such as openai/clip-vit-base-patch16.
        where: The setting that names it, for messages.

    Raises:
        BadInput: It is neither a folder nor a model of the hub that can be had.
        BadSetting: It is of the hub and huggingface_hub is not installed.
    """
    local = Path(weights).expanduser()
    if weights and local.is_dir():
        return local
    if not HUB_NAME.fullmatch(weights):
        raise BadInput(f"{where}: there is no folder {weights!r}; name one that holds a checkpoint")
    return _cached(weights, where) or _fetched(weights, where)


def _cached(name: str, where: str) -> Path | None:
    """Return the folder of a model of the hub that was fetched before."""
    try:
        from huggingface_hub import snapshot_download
    except ImportError as error:
        raise BadSetting(
            f"{where}: a model of the hub needs huggingface_hub; pip install 'upvl[clip]'"
        ) from error
    try:
        here = Path(snapshot_download(name, allow_patterns=HUB_PATTERNS, local_files_only=True))
    except Exception:  # not here, or not whole; fetching it says what is wrong
        return None
    # Another program may have fetched no more than the tokenizer.
    return here if (here / "config.json").is_file() and any(here.glob(WEIGHTS)) else None


def _fetched(name: str, where: str) -> Path:
    """Fetch a model of the hub and return its folder."""
    from huggingface_hub import snapshot_download

    try:
        return Path(snapshot_download(name, allow_patterns=HUB_PATTERNS))
    except Exception as error:  # the hub, the network and the disk fail in many ways, none of them ours
        raise BadInput(
            f"{where}: {name!r} is no folder here and could not be fetched from the Hugging Face hub "
            f"({one_line(error)}); download it and name its folder"
        ) from error


def files(
    checkpoint: Path,
    kinds: Sequence[str],
    needed: Sequence[str] = (),
    hints: Mapping[str, str] | None = None,
) -> tuple[Path, ...]:
    """Return the files that make a checkpoint, sorted; they are checked, but the weights are not read.

    Args:
        checkpoint: Its folder.
        kinds: Values of `model_type` that can be read.
        needed: Files that it must have beside its config, weights and tokenizer.
        hints: What to do about other values of `model_type`.

    Raises:
        BadInput: Files are missing, the weights are pickles, or it is of another kind.
    """
    missing = [name for name in ("config.json", *needed) if not (checkpoint / name).is_file()]
    if not any(checkpoint.glob(WEIGHTS)):
        pickled = any(checkpoint.glob("*.bin")) or any(checkpoint.glob("*.pt"))
        missing.append(WEIGHTS + " (its weights are pickles, which are never loaded)" * pickled)
    if not any((checkpoint / name).is_file() for name in TOKENIZERS):
        missing.append(" or ".join(TOKENIZERS))
    if missing:
        raise BadInput(
            f"{checkpoint}: lacks {', '.join(missing)}; "
            "expected a checkpoint as save_pretrained of transformers writes it"
        )
    found = read_json(checkpoint / "config.json").get("model_type")
    if found not in kinds:
        hint = (hints or {}).get(str(found), "")
        raise BadInput(
            f"{checkpoint / 'config.json'}: model_type is {found!r}, expected {' or '.join(kinds)}"
            + f"; {hint}" * bool(hint)
        )
    names = {"config.json", *needed, *TOKENIZERS, *BESIDE}
    listed = [checkpoint / name for name in names if (checkpoint / name).is_file()]
    return tuple(sorted([*listed, *checkpoint.glob(WEIGHTS), *checkpoint.glob(WEIGHTS + ".index.json")]))


def read_json(path: Path) -> dict[str, Any]:
    """Return the object that a JSON file holds.

    Raises:
        BadInput: It holds something else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: cannot be read as JSON ({one_line(error)})") from error
    if not isinstance(content, dict):
        raise BadInput(f"{path}: holds a {type(content).__name__}, expected an object of JSON")
    return content


@contextmanager
def transformers_errors(checkpoint: Path) -> Iterator[None]:
    """Silence transformers while it reads a checkpoint, and raise its failures as errors of one line.

    Its report would list the other tower's weights as unexpected, on every run.

    Raises:
        BadSetting: A library is not installed.
        BadInput: A file cannot be read.
    """
    try:
        from transformers.utils import logging as transformers_logging
    except ImportError as error:
        raise BadSetting(f"{checkpoint}: reading it needs transformers; pip install 'upvl[clip]'") from error
    from safetensors import SafetensorError

    logging: Any = transformers_logging  # its functions have no types
    level, bars = logging.get_verbosity(), logging.is_progress_bar_enabled()
    logging.set_verbosity_error()
    logging.disable_progress_bar()
    try:
        yield
    except ImportError as error:  # the tokenizer of SigLIP is made by sentencepiece
        raise BadSetting(f"{checkpoint}: {one_line(error)}; pip install 'upvl[clip]'") from error
    except (OSError, ValueError, KeyError, RuntimeError, SafetensorError) as error:
        raise BadInput(f"{checkpoint}: transformers cannot read it ({one_line(error)})") from error
    finally:
        logging.set_verbosity(level)
        if bars:
            logging.enable_progress_bar()


def config(checkpoint: Path) -> Any:
    """Return the configuration of a checkpoint, with the defaults of its kind filled in."""
    with transformers_errors(checkpoint):
        from transformers import AutoConfig

        return AutoConfig.from_pretrained(checkpoint, local_files_only=True, trust_remote_code=False)


def tokenizer(checkpoint: Path) -> Any:
    """Return the tokenizer of a checkpoint."""
    with transformers_errors(checkpoint):
        from transformers import AutoTokenizer

        return AutoTokenizer.from_pretrained(checkpoint, local_files_only=True, trust_remote_code=False)


def load_tower(kind: Any, checkpoint: Path, configuration: Any) -> Any:
    """Load one network of a checkpoint, in float32, on the accelerator if there is one.

    Args:
        kind: Class of the network, of the library transformers.
        checkpoint: Folder; weights of other networks in it are not read.
        configuration: Configuration of this network.

    Raises:
        BadInput: Weights are missing or have other shapes.
    """
    import torch

    with transformers_errors(checkpoint):
        network, report = kind.from_pretrained(
            checkpoint,
            config=configuration,
            dtype=torch.float32,
            use_safetensors=True,
            local_files_only=True,
            trust_remote_code=False,
            output_loading_info=True,
        )
    if report["missing_keys"]:
        raise BadInput(f"{checkpoint}: lacks weights: {', '.join(sorted(report['missing_keys'])[:3])}, ...")
    return network.to("cuda" if torch.cuda.is_available() else "cpu")
