"""The Oxford affine covariant features set: eight planar or rotating scenes under growing changes,
with homographies.

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
    data: str | os.PathLike | None = None, sequences: Iterable[str] | None = None
) -> Iterator[Pair]:
    """Pairs 1-2 ... 1-6 of each sequence, with H.

    Args:
        data: folder that holds ``oxford/``; None: ``SFMKIT_DATA``, or what was fetched.
        sequences: names in :data:`SEQUENCES`; None for all that are there.

    Raises:
        InputError: the data set, a sequence, an image or a homography is missing or unreadable.
    """
    root = data_root("oxford", data)
    for sequence in choose_sequences(root, SEQUENCES, sequences):
        folder = root / sequence
        first = find_image(folder, "img1")
        for k in range(2, 7):
            H = read_homography(folder / f"H1to{k}p")
            yield Pair("oxford", sequence, f"1-{k}", first, find_image(folder, f"img{k}"), H=H)
