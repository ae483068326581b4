"""Compare the time to read a photograph: sfmkit, Pillow and OpenCV, alternating in one process.

python benchmarks/read.py [PHOTO]
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from statistics import median

import cv2
import numpy as np
import PIL.Image

from sfmkit.io.images import read_image

ROUNDS = 15


def main(path: Path) -> None:
    def pillow():
        rgb = np.asarray(PIL.Image.open(path))
        return rgb, cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)

    def opencv():
        return cv2.imread(str(path)), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)

    ways = {
        "sfmkit.read_image": lambda: read_image(path),
        "Pillow + cvtColor": pillow,
        "cv2.imread, twice": opencv,
    }
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(ROUNDS):
        for name, read in ways.items():
            start = time.perf_counter()
            read()
            seconds[name].append(time.perf_counter() - start)
    best = median(seconds["sfmkit.read_image"])
    print(f"{path.name}, {' x '.join(map(str, read_image(path).size_wh))}, median of {ROUNDS}")
    print("| reads colour and grey | ms | times ours |\n|---|---|---|")
    for name, values in seconds.items():
        print(f"| {name} | {median(values) * 1e3:.0f} | {median(values) / best:.2f} |")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    elif folder := os.environ.get("SFMKIT_DATA"):
        main(Path(folder) / "strecha" / "fountain-P11" / "images" / "0000.jpg")
    else:
        sys.exit("name a photograph, or set SFMKIT_DATA")
