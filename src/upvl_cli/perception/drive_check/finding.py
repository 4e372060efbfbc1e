"""What a check says of a drive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Literal

Level = Literal["ok", "cannot tell", "warning", "fault"]  # from good to bad
LEVELS: tuple[Level, ...] = ("ok", "cannot tell", "warning", "fault")


def correction(line: str) -> str:
    """Return the remedy that a line of the user's corrections is: `metres_per_unit = 0.3048`."""
    return f"set {line} under [corrections] in raw.toml"


@dataclass(frozen=True)
class Finding:
    """One result of a check.

    Attributes:
        subject: What it is about: "poses", "points", "axes", "clock", "sensor", "labels", or "camera NAME".
        level: "fault" where labels would be wrong, "warning" where they may be, "cannot tell" where the sample does
            not show it, else "ok".
        text: What was found, in one sentence with figures.
        where: Frames that show it; empty for the whole drive.
        evidence: How sure it is: how many of how many sweeps, pairs or pictures, or standard deviations.
        cause: The likely cause; empty where there is none to name.
        remedy: What to do about it; a line for `raw.toml` where one helps.
    """

    subject: str
    level: Level
    text: str
    where: str = ""
    evidence: str = ""
    cause: str = ""
    remedy: str = ""

    @property
    def is_fault(self) -> bool:
        """Whether labels made from the drive would be wrong."""
        return self.level == "fault"

    @property
    def sentence(self) -> str:
        """The finding in one line."""
        notes = ", ".join(part for part in (self.where, self.evidence) if part)
        line = f"{self.subject}: {self.text}" + (f" ({notes})" if notes else "")
        line += f"; likely cause: {self.cause}" if self.cause else ""
        return line + (f"; {self.remedy}" if self.remedy else "")

    def to_json(self) -> Mapping[str, str]:
        """Return the finding as plain texts."""
        return asdict(self)
