"""Reads the values of `stages/*.toml` and checks them against their declarations."""

from __future__ import annotations

import difflib
import math
import reprlib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args, get_origin

from upvl_cli.errors import BadSetting, one_line
from upvl_cli.stage import Param, params_of


def load(settings: type[Any], path: Path, overrides: Mapping[str, Any] | None = None) -> Any:
    """The settings in a TOML file, with values of the command line over them.

    Args:
        settings: Dataclass of `param`s.
        path: The TOML file.
        overrides: Values that replace those of the file.

    Raises:
        BadSetting: The file is missing or is no TOML, or keys or values are wrong: all of them
            in one message.
    """
    values = {**read_toml(path), **(overrides or {})}
    declared = params_of(settings)
    faults = [
        f"missing key {name!r} ({spec.meaning})" for name, (_, spec) in declared.items() if name not in values
    ]
    faults += [_unknown(name, tuple(declared)) for name in values if name not in declared]
    checked: dict[str, Any] = {}
    for name, (kind, spec) in declared.items():
        if name in values:
            checked[name], fault = _check(name, values[name], kind, spec)
            faults += [fault] if fault else []
    if faults:
        raise BadSetting(f"{path}: {'; '.join(faults)}")
    return settings(**checked)


def read_toml(path: Path) -> dict[str, Any]:
    """The values of a TOML file.

    Raises:
        BadSetting: The file is missing or is no TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise BadSetting(
            f"{path} is missing: a workspace has one file of settings a stage; run upvl in a workspace, or "
            "make one with: upvl init DIR"
        ) from None
    except (ValueError, RecursionError) as error:
        raise BadSetting(f"{path} is not valid TOML: {one_line(error)}") from None
    except OSError as error:
        raise BadSetting(f"{path} cannot be read: {error.strerror}") from None


def _unknown(name: str, known: tuple[str, ...]) -> str:
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    return f"unknown key {name!r}{hint} (known: {', '.join(known) or 'none'})"


def _check(name: str, value: Any, kind: type[Any], spec: Param) -> tuple[Any, str]:
    """The value in its declared type and "", or the value as it is and what is wrong with it."""
    if get_origin(kind) is tuple:
        return _check_list(name, value, get_args(kind)[0], spec)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value) if abs(value) < _LARGEST else math.inf
    shown = reprlib.repr(value)
    if type(value) is not kind:
        return value, f"{name} = {shown} must be {_WORDS[kind]}"
    if not spec.allows(value):
        unit = f" {spec.unit}" if spec.unit else ""
        return value, f"{name} = {shown} must be {spec.bounds or 'finite'}{unit} ({spec.meaning})"
    return value, ""


def _check_list(name: str, value: Any, kind: type[Any], spec: Param) -> tuple[Any, str]:
    if not isinstance(value, (list, tuple)):
        return value, f"{name} = {reprlib.repr(value)} must be a list of {_WORDS[kind]}"
    items = [_check(f"{name}[{index}]", item, kind, spec) for index, item in enumerate(value)]
    return tuple(item for item, _ in items), "; ".join(fault for _, fault in items if fault)


_LARGEST = 10**300  # a whole number beyond this is no float
_WORDS = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
