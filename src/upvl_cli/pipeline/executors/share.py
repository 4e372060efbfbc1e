"""The share of a run that one of many processes takes which know nothing of each other."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from upvl_cli.errors import BadSetting

_FORM = re.compile(r"(\d{1,9})/(\d{1,9})", re.ASCII)


@dataclass(frozen=True)
class Share:
    """The drives `number`, `number + count`, `number + 2 count`, ... of the sorted list, counted from 1."""

    number: int
    count: int

    @classmethod
    def parse(cls, text: str, option: str = "--shard") -> Share:
        """Return the share that an option names, such as 3/64.

        Raises:
            BadSetting: It is no share.
        """
        found = _FORM.fullmatch(text)
        number, count = map(int, found.groups()) if found else (0, 0)
        if not 1 <= number <= count:
            raise BadSetting(
                f"{option} {text!r}: expected I/N with I from 1 to N, such as 3/64; where a scheduler counts from 0, "
                "as Kubernetes does, give $((JOB_COMPLETION_INDEX + 1))/64"
            )
        return cls(number, count)

    def of(self, segments: Sequence[str]) -> list[str]:
        """Return the drives of this share; none where there are more shares than drives."""
        return sorted(segments)[self.number - 1 :: self.count]

    def without(self, segment: str, segments: Sequence[str]) -> list[Share]:
        """Return shares that have the drives of this one, but for one drive; none where it has no other.

        Args:
            segment: The drive that is left out.
            segments: All drives that are shared out.
        """
        halves = (Share(self.number, 2 * self.count), Share(self.number + self.count, 2 * self.count))
        kept: list[Share] = []
        for half in halves if len(self.of(segments)) > 1 else ():
            kept += half.without(segment, segments) if segment in half.of(segments) else [half]
        return kept
