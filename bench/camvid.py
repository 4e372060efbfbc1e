"""How well `mini` tells CamVid's classes by words alone: python bench/camvid.py ../shared/data/camvid.

Mean IoU over the 11 classes of the test split, by the classes' own words, and with each word replaced by
synonyms that no training saw (those of training/mini/words.toml under `test`).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "training" / "mini"))
from evaluate import camvid_miou

from upvl_cli.vlm.mini import Mini


def main() -> None:
    """Print the scores; exits 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", type=Path)
    parser.add_argument("--split", default="test")
    parser.add_argument("--every", type=int, default=1)
    options = parser.parse_args()
    model = Mini()
    score = camvid_miou(model.embed_image, model.text, options.root, options.split, options.every)
    names = (options.root / "classes.txt").read_text().splitlines()
    print("  ".join(f"{name} {iou:.3f}" for name, iou in zip(names, score.each, strict=False)))
    print(
        f"mIoU by the classes' words {score.words:.3f} (bar 0.60), by unseen synonyms {score.synonyms:.3f} (bar 0.50)"
    )
    for words, value in score.rounds:
        print(f"  {value:.3f}  {', '.join(words)}")
    sys.exit(not (score.words >= 0.60 and score.synonyms >= 0.50))


if __name__ == "__main__":
    main()
