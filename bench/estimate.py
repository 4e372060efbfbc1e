"""An estimate from two drives against the true figures of all drives of a labelled workspace.

    python bench/estimate.py --workspace FOLDER [--sample 2]

Takes the run log of a workspace in which several drives have been labelled; labels nothing. Of every choice of that
many drives it estimates what all drives take, and prints the ratio of the estimate to the true figure: for the choice
that `upvl plan --estimate` proposes, the smallest and the largest, and how often the true figure lay in the range. To
make one: upvl init FOLDER, train = 6 and frames = 10 in stages/synthetic.toml, upvl autolabel --moving-only.
"""

from __future__ import annotations

import argparse
from itertools import combinations, islice
from pathlib import Path

from upvl_cli.commands.cost_estimate import CostEstimate
from upvl_cli.commands.estimate_cost import estimate_cost, sampled_drives
from upvl_cli.commands.pipeline import PIPELINE
from upvl_cli.pipeline.workspace import Workspace

MOST_CHOICES = 200


def quantities(estimate: CostEstimate) -> dict[str, tuple[float, float, float]]:
    """Return the lower end, the estimate and the upper end of each quantity."""
    total = estimate.total
    peak = total.peak_mib or 0.0
    ranges = {"CPU hours": total.cpu_h, "bytes": total.size_bytes, "elapsed hours": total.elapsed_h}
    found = {name: (values.low, values.mean, values.high) for name, values in ranges.items()}
    return found | {"peak memory": (peak, peak, peak)}


def main() -> None:
    """Print the ratios."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--workspace", type=Path, required=True, help="Folder with stages/ and out/.")
    parser.add_argument("--sample", type=int, default=2, help="Number of drives to estimate from.")
    chosen = parser.parse_args()
    workspace = Workspace(PIPELINE, chosen.workspace / "stages", chosen.workspace / "out")
    drives = sampled_drives(workspace)
    if len(drives) <= chosen.sample:
        parser.error(f"{chosen.workspace}: {len(drives)} labelled drives, expected more than {chosen.sample}")
    truth = quantities(estimate_cost(workspace, drives=len(drives), sample=drives))
    proposed = tuple(drives[(2 * n + 1) * len(drives) // (2 * chosen.sample)] for n in range(chosen.sample))
    choices = [proposed, *islice(combinations(drives, chosen.sample), MOST_CHOICES)]
    estimates = [
        quantities(estimate_cost(workspace, drives=len(drives), sample=choice)) for choice in choices
    ]
    print(f"{len(drives)} drives; estimated from {chosen.sample}: {', '.join(proposed)}; estimate / true")
    print(
        f"{'':14} {'ratio':>6} {'smallest':>9} {'largest':>8} {'in range':>9}   of {len(choices) - 1} choices"
    )
    for name, (_, true, _) in truth.items():
        ratios = [estimate[name][1] / true for estimate in estimates]
        inside = [low <= true <= high for low, _, high in (estimate[name] for estimate in estimates[1:])]
        share = f"{sum(inside)}/{len(inside)}" if name != "peak memory" else ""
        print(f"{name:14} {ratios[0]:6.3f} {min(ratios[1:]):9.3f} {max(ratios[1:]):8.3f} {share:>9}")


if __name__ == "__main__":
    main()
