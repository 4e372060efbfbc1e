"""Settings: frozen dataclasses whose fields carry a meaning, a unit and a range, and whose values stand in TOML.

A value lives in `stages/<stage>.toml` alone; only a correction, which most workspaces have none of, has a default
here, and may be left out there. pydantic checks the values
(`config.toml`); it is imported only when a file is read, so that `upvl --help` stays quick.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints


@dataclass(frozen=True)
class Config:
    """Base of all settings: unknown keys are refused, and no value is converted to another type."""

    def values(self) -> dict[str, Any]:
        """Return all values as plain numbers, texts, lists and nested dicts, for a stamp."""
        return asdict(self)

    def files(self, segment: str) -> tuple[Path, ...]:
        """Return the files beside the drive's own that a stage with these settings reads: their content is stamped.

        Args:
            segment: Name of the drive.
        """
        return ()


def setting(
    meaning: str,
    unit: str = "",
    *,
    gt: float | None = None,
    ge: float | None = None,
    le: float | None = None,
    effects: Mapping[str, str] | None = None,
    default: Any = MISSING,
) -> Any:
    """Declare one setting; its value stands in the TOML file.

    Args:
        meaning: What the value does: a sentence without a full stop that can be read alone.
        unit: Its unit, for example "m/s"; empty for a pure number or a text.
        gt: The value is above this.
        ge: The value is this or more.
        le: The value is this or less.
        effects: For a `Literal` of texts, what each choice does.
        default: The value where the TOML file has none; without it the key must be there.
    """
    bounds = {"gt": gt, "ge": ge, "le": le}
    metadata = {"meaning": meaning, "unit": unit, **bounds, "effects": dict(effects or {})}
    return field(metadata=metadata, default=default)


def table(meaning: str, default: Any = MISSING) -> Any:
    """Declare a nested table of settings, `[name]` in the TOML file, whose type is a `Config`.

    Args:
        meaning: What the table holds.
        default: The settings where the TOML file has no such table; without it the table must be there.
    """
    return field(metadata={"meaning": meaning}, default=default)


@dataclass(frozen=True)
class Setting:
    """One declared setting.

    Attributes:
        path: Names from the outer table to the value: ("rigid", "eps_m") is `eps_m` in the table `[rigid]`.
        type: Its Python type; a tuple holds items of one type.
        meaning: What the value does.
        unit: Its unit.
        gt: Lower bound that the value exceeds, or None.
        ge: Lower bound that the value may equal, or None.
        le: Upper bound that the value may equal, or None.
        effects: What each choice does, where only some texts are allowed.
    """

    path: tuple[str, ...]
    type: Any
    meaning: str
    unit: str
    gt: float | None
    ge: float | None
    le: float | None
    effects: Mapping[str, str]

    @property
    def name(self) -> str:
        """The name as it is written in messages and tables: `rigid.eps_m`."""
        return ".".join(self.path)

    @property
    def choices(self) -> tuple[str, ...]:
        """The allowed texts, where only some are."""
        return tuple(get_args(self.type)) if get_origin(self.type) is Literal else ()

    @property
    def bounds(self) -> str:
        """The range in words, for messages, help and docs; empty where there is none."""
        parts = [
            f"> {self.gt:g}" if self.gt is not None else "",
            f">= {self.ge:g}" if self.ge is not None else "",
            f"<= {self.le:g}" if self.le is not None else "",
            f"one of {', '.join(self.choices)}" if self.choices else "",
        ]
        return " and ".join(part for part in parts if part)

    def value_in(self, config: Config) -> Any:
        """Return the value of this setting in loaded settings."""
        value: Any = config
        for name in self.path:
            value = getattr(value, name)
        return value


def settings_of(config: type[Config], above: tuple[str, ...] = ()) -> Iterator[Setting]:
    """Yield every setting of a class, those of nested tables too, in the order of their declaration."""
    hints = get_type_hints(config)
    for spec in fields(config):
        kind, path = hints[spec.name], (*above, spec.name)
        if isinstance(kind, type) and issubclass(kind, Config):
            yield from settings_of(kind, path)
        else:
            yield Setting(path, kind, **spec.metadata)
