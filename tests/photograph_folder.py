"""Folders of photographs: a made-up one of two planes, and a few of the fountain."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import PIL.Image
from small_sweep import InlineEngine

from sfmkit.ablation import engine_choice as module
from sfmkit.mapping import MatchedFolder, Workshop, match_folder
from sfmkit.options import DEFAULT

SIZE = (320, 240)
K = "300,300,159.5,119.5"


def scene(folder: Path, count: int = 3, step: int = 24) -> Path:
    """Write photographs of two textured planes at different depths, with the camera moving."""
    rng = np.random.default_rng(0)
    folder.mkdir(parents=True, exist_ok=True)
    planes = [
        cv2.resize(rng.integers(0, 255, (150, 300, 3), np.uint8), None, fx=3, fy=3) for _ in "12"
    ]
    for k in range(count):
        w, h = SIZE
        back = planes[0][100 : 100 + h, 100 + k * step : 100 + k * step + w].copy()
        x = 60 + 2 * k * step
        near = planes[1][20 : 20 + h // 2, x : x + w]
        back[h // 2 :] = near[: h - h // 2]
        PIL.Image.fromarray(back).save(folder / f"{k}.png")
    return folder


def fountain(data: Path, folder: Path, count: int = 4) -> Path:
    """Link to some photographs of the fountain that follow each other."""
    folder.mkdir(parents=True, exist_ok=True)
    for file in sorted((data / "strecha/fountain-P11/images").glob("*.jpg"))[3 : 3 + count]:
        os.symlink(file, folder / file.name)
    return folder


def match_small(folder: Path, cache: Path, intrinsics: str) -> MatchedFolder:
    """Match a folder at a small size, in this process."""
    before, module.LocalEngine = module.LocalEngine, InlineEngine
    try:
        detect = replace(DEFAULT.detect, max_size=640, budget=2_000)
        return match_folder(
            folder,
            intrinsics=intrinsics,
            operators=("surf", "orb", "fast-brief"),
            options=replace(DEFAULT, detect=detect),
            workshop=Workshop.of(cache, workers=1),
        )
    finally:
        module.LocalEngine = before
