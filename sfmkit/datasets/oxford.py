"""The Oxford affine covariant features set: eight sequences with homographies.

The scenes are planar, or the camera rotates. Each sequence has one change that grows from image to
image.

Mikolajczyk et al., "A comparison of affine region detectors", IJCV 2005.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator

from .pair import Pair, choose_sequences, data_root, find_image, read_homography

# The change from image 1 to image 6, in the order of the paper's tables.
SEQUENCES = {
    "bark": "zoom and rotation",
    "boat": "zoom and rotation",
    "bikes": "blur",
    "trees": "blur",
    "graf": "viewpoint",
    "wall": "viewpoint",
    "leuven": "light",
    "ubc": "JPEG compression",
}


def oxford(
    root: str | os.PathLike | None = None, sequences: Iterable[str] | None = None
) -> Iterator[Pair]:
    """Yield the pairs 1-2 ... 1-6 of each sequence, with H.

    Args:
        root: Folder that contains ``oxford/``; None for ``SFMKIT_DATA`` or the folder of downloads.
        sequences: Names in :data:`SEQUENCES`; None for all that are present.

    Raises:
        InputError: The data set, a sequence, an image or a homography is missing or unreadable.
    """
    home = data_root("oxford", root)
    for sequence in choose_sequences(home, SEQUENCES, sequences):
        folder = home / sequence
        first = find_image(folder, "img1")
        for k in range(2, 7):
            H = read_homography(folder / f"H1to{k}p")
            yield Pair("oxford", sequence, f"1-{k}", first, find_image(folder, f"img{k}"), H=H)
