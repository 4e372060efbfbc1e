"""Read `stages/*.toml` into typed settings, and say everything that is wrong with a file at once."""

from __future__ import annotations

import difflib
import json
import reprlib
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

from upvl_cli.config.base import Config, Setting, settings_of
from upvl_cli.errors import BadSetting, one_line

if TYPE_CHECKING:
    from pydantic import BaseModel
    from pydantic_core import ErrorDetails

C = TypeVar("C", bound=Config)
Values = Mapping[str, object]


def load(config: type[C], path: Path, overrides: Values | None = None) -> C:
    """Return the settings in a TOML file, with values of a preset or of the command line over them.

    Args:
        config: The declared settings.
        path: The TOML file.
        overrides: Values that replace those of the file; a nested table replaces only what it names.

    Raises:
        BadSetting: The file is missing or is no TOML, or keys or values are wrong: all of them in one message.
    """
    return parse(config, merge(read_toml(path), overrides or {}), path)


def parse(config: type[C], values: Values, source: Path) -> C:
    """Return checked settings; `source` is the file that a message names.

    Raises:
        BadSetting: Keys or values are wrong: all of them in one message.
    """
    from pydantic import ValidationError

    declared = {setting.path: setting for setting in settings_of(config)}
    try:
        # As JSON: strict about numbers and texts, but a table may become a dataclass and a list a tuple.
        checked = _model_of(config).model_validate_json(json.dumps(values, default=str))
    except ValidationError as error:
        faults = dict.fromkeys(_fault(found, config, declared) for found in error.errors(include_url=False))
        raise BadSetting(f"{source}: {'; '.join(faults)}") from None
    return _config_of(config, checked)


def merge(values: Values, over: Values) -> dict[str, object]:
    """Return the values with others over them, table by table."""
    merged = dict(values)
    for name, value in over.items():
        below = merged.get(name)
        if isinstance(value, Mapping) and isinstance(below, Mapping):
            value = merge(below, value)
        merged[name] = value
    return merged


def read_toml(path: Path) -> dict[str, object]:
    """Return the values of a TOML file.

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


_models: dict[type[Config], type[BaseModel]] = {}


def _model_of(config: type[Config]) -> type[BaseModel]:
    """Return the pydantic model of the settings, built once: that takes a hundredth of a second."""
    if config not in _models:
        _models[config] = _build_model(config)
    return _models[config]


def _build_model(config: type[Config]) -> type[BaseModel]:
    """Return the pydantic model that checks the settings: strict types, bounds of each item, no unknown keys."""
    from pydantic import ConfigDict, Field, create_model

    hints, parts = get_type_hints(config), dict[str, Any]()
    for spec in fields(config):
        kind = hints[spec.name]
        if isinstance(kind, type) and issubclass(kind, Config):
            # Where the table is left out, so are its keys: each must have a default then.
            inner = _model_of(kind)
            parts[spec.name] = (inner, ... if spec.default is MISSING else Field(default_factory=inner))
            continue
        default = ... if spec.default is MISSING else spec.default
        bounds = Field(**{name: spec.metadata[name] for name in ("gt", "ge", "le")}, allow_inf_nan=False)
        if get_origin(kind) is tuple:
            item: Any = get_args(kind)[0]
            item = Annotated[item, bounds] if item is not str else item
            parts[spec.name] = (tuple[item, ...], default)
        else:
            parts[spec.name] = (Annotated[kind, bounds] if kind in (int, float) else kind, default)
    return create_model(config.__name__, __config__=ConfigDict(extra="forbid", strict=True), **parts)


def _config_of(config: type[C], checked: BaseModel) -> C:
    """Return the settings as the declared dataclass."""
    hints, values = get_type_hints(config), dict[str, object]()
    for name, value in checked:
        values[name] = _config_of(hints[name], value) if hasattr(value, "model_fields_set") else value
    return config(**values)


def _fault(found: ErrorDetails, config: type[Config], declared: Mapping[tuple[str, ...], Setting]) -> str:
    """Return in words what is wrong with one key or value."""
    at = tuple(str(part) for part in found["loc"] if not isinstance(part, int))
    spec = declared.get(at)
    if found["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
        return _unknown(at, config)
    if found["type"] == "missing":
        return f"missing key {'.'.join(at)!r}" + (f" ({spec.meaning})" if spec else "")
    item = "".join(f"[{part}]" for part in found["loc"] if isinstance(part, int))
    shown = f"{'.'.join(at)}{item} = {reprlib.repr(found['input'])}"
    if spec is None:
        return f"{shown} must be a table of settings"
    if found["type"].endswith("_type") or found["type"] in ("int_from_float", "is_instance_of"):
        return f"{shown} must be {_type_in_words(spec, bool(item))}"
    unit = f" {spec.unit}" if spec.unit else ""
    return f"{shown} must be {spec.bounds or 'finite'}{unit} ({spec.meaning})"


def _unknown(at: tuple[str, ...], config: type[Config]) -> str:
    known = tuple(dict.fromkeys(_names_in(config, at[:-1])))
    close = difflib.get_close_matches(at[-1], known, n=1)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    return f"unknown key {'.'.join(at)!r}{hint} (known: {', '.join(known) or 'none'})"


def _names_in(config: type[Config], table: tuple[str, ...]) -> Iterator[str]:
    depth = len(table)
    for spec in settings_of(config):
        if spec.path[:depth] == table:
            yield spec.path[depth]


def _type_in_words(spec: Setting, is_item: bool) -> str:
    if get_origin(spec.type) is tuple:
        kind = get_args(spec.type)[0]
        return _WORDS[kind] if is_item else f"a list of {_PLURALS[kind]}"
    return spec.bounds if spec.choices else _WORDS[spec.type]


_WORDS = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
_PLURALS = {float: "numbers", int: "whole numbers", str: "texts"}
