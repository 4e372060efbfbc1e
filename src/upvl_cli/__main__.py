"""Starts `upvl` where a module is asked for: `torchrun --nproc-per-node 2 -m upvl_cli train`."""

from __future__ import annotations

from upvl_cli.start import main

if __name__ == "__main__":
    main()
