"""Make the pictures of the documentation that show the bundled pair.

    python benchmarks/pictures.py [--out docs/images]

The picture of the matches contains the per-operator statistics of its run as a JPEG comment, so
that a test can compare them with those of the current version. The pictures of ablations and of the
accuracy come from `sfmkit ablate report` and `benchmarks/sweep.py`. Screenshots of the viewer and
of notebook 04 come from the browser tests, which write them to the folder SFMKIT_ARTEFACTS.
"""

from __future__ import annotations

import argparse
import io
import json
from pathlib import Path
from typing import Any

import PIL.Image

import sfmkit
from sfmkit.clouds.density import density, histogram
from sfmkit.datasets.synthetic import demo_pair
from sfmkit.io.intrinsics import parse_intrinsics
from sfmkit.viz.density_figures import density_figure, histogram_figure
from sfmkit.viz.figures import match_picture, save

OPERATORS = ("surf", "orb", "fast-brief")
WIDTH = 1300  # pixels of the picture of the matches
COUNTS = ("matches", "inliers", "points")


def demo() -> sfmkit.Reconstruction:
    """Reconstruct the bundled pair with the default options."""
    path1, path2, truth = demo_pair()
    camera = parse_intrinsics(truth, sfmkit.read_image(path1).size_wh)
    return sfmkit.reconstruct(path1, path2, camera, operators=OPERATORS)


def statistics(result: sfmkit.Reconstruction) -> dict[str, dict[str, int]]:
    """Return the counts of each operator."""
    return {
        name: {count: int(getattr(line, count)) for count in COUNTS}
        for name, line in result.account.items()
    }


def rendered(figure: Any, dpi: int) -> PIL.Image.Image:
    """Render a figure to an image."""
    buffer = io.BytesIO()
    save(figure, buffer, dpi=dpi)  # type: ignore[arg-type]  # matplotlib writes to a file object too
    return PIL.Image.open(buffer).convert("RGB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path(__file__).parents[1] / "docs" / "images")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    result = demo()
    picture = rendered(match_picture(result), dpi=150)
    picture.thumbnail((WIDTH, WIDTH), PIL.Image.Resampling.LANCZOS)
    comment = json.dumps(statistics(result)).encode()
    picture.save(out / "demo-matches.jpg", quality=88, optimize=True, comment=comment)
    found = density(result.cloud.xyz.numpy())
    for name, figure in (
        ("density-demo", density_figure(result.cloud, found)),
        ("density-histogram-demo", histogram_figure(found, histogram(found.neighbours))),
    ):
        # 256 colours are sufficient for these figures and halve the file.
        rendered(figure, dpi=110).quantize(256).save(out / f"{name}.png", optimize=True)
    print(f"wrote 3 pictures to {out}")


if __name__ == "__main__":
    main()
