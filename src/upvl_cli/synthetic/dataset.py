"""The built-in dataset: drives through a made-up city, the same for the same settings."""

from __future__ import annotations

import difflib
from typing import Any

from upvl_cli.errors import BadInput, BadSetting
from upvl_cli.synthetic.config import SPLITS, CityConfig
from upvl_cli.synthetic.drive import CityDrive
from upvl_cli.synthetic.kinds import KINDS


class City:
    """The made-up drives (a `Dataset`)."""

    version = 1

    def __init__(self, settings: CityConfig) -> None:
        """Offer the drives.

        Raises:
            BadSetting: A kind that is held out is none.
        """
        for name in settings.held_out:
            if name not in KINDS:
                close = difflib.get_close_matches(name, KINDS, n=1)
                hint = f"; did you mean {close[0]!r}?" if close else f"; they are {', '.join(KINDS)}"
                raise BadSetting(f"synthetic.toml: held_out has {name!r}, which is no kind of object{hint}")
        self.settings = settings
        self._last: CityDrive | None = None

    @property
    def fingerprint_values(self) -> dict[str, Any]:
        """Those settings that make a drive what it is; how many others there are does not."""
        return {name: value for name, value in self.settings.values().items() if name not in SPLITS}

    @property
    def segments(self) -> tuple[str, ...]:
        """Names of all drives, sorted."""
        counts = {split: getattr(self.settings, split) for split in SPLITS}
        return tuple(sorted(f"{split}-{number:03d}" for split in SPLITS for number in range(counts[split])))

    def open(self, segment: str) -> CityDrive:
        """Return the drive of that name; the last one is kept.

        Raises:
            BadInput: There is no such segment.
        """
        if segment not in self.segments:
            raise BadInput(
                f"the synthetic dataset has no segment {segment!r}; it has {', '.join(self.segments)}"
            )
        drive = self._last
        if drive is None or drive.name != segment:  # a city takes seconds to build
            split, _, number = segment.rpartition("-")
            drive = self._last = CityDrive(
                name=segment,
                seed=(self.settings.seed, SPLITS.index(split), int(number)),
                without=self.settings.held_out if split == "train" else (),
                settings=self.settings,
            )
        return drive
