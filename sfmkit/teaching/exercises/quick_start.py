"""Notebook 00: the quick start."""

from __future__ import annotations

import numpy as np

from ..exercise import Exercise

EXERCISES: dict[str, Exercise] = {
    "00.1": Exercise(
        "How many degrees wide is the view of a camera with a focal length of 1472 px and an image of 1600 px?",
        lambda: np.degrees(2 * np.arctan(800 / 1472)),
        (
            (
                lambda: 2 * np.arctan(800 / 1472),
                "That is the angle in radians; np.degrees converts it.",
            ),
            (
                lambda: np.degrees(np.arctan(800 / 1472)),
                "That is the angle from the middle to the edge: half of the view.",
            ),
            (
                lambda: np.degrees(np.arctan(1600 / 1472)),
                "The triangle's legs are the focal length and HALF the image's width.",
            ),
        ),
    ),
    "00.2": Exercise(
        "The cloud is in units of the baseline. The cameras stood 1.36 m apart: how many metres deep is a point with z = 8?",
        lambda: 8 * 1.36,
        (
            (
                lambda: 8 / 1.36,
                "One unit of the cloud is one baseline: 1.36 m. Eight of them are more than eight metres.",
            ),
        ),
    ),
    "00.3": Exercise(
        "Which of these numbers of one run cannot be larger than any of the others: 'keypoints', 'matches', 'inliers', "
        "'points'?",
        lambda: "points",
        (
            (
                lambda: "inliers",
                "Close: a point of the cloud is a triangulated inlier, and some are left out.",
            ),
            (
                lambda: "matches",
                "Matches are made first; the geometry then throws some of them out.",
            ),
            (
                lambda: "keypoints",
                "There are as many keypoints as the detector finds; only some of them find a partner.",
            ),
        ),
    ),
}
