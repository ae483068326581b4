"""Notebook 00: the quick start."""

from __future__ import annotations

import numpy as np

from ..exercise import Exercise

EXERCISES: dict[str, Exercise] = {
    "00.1": Exercise(
        "A camera has a focal length of 1472 px and an image width of 1600 px. What is its "
        "horizontal "
        "field of view in degrees?",
        lambda: np.degrees(2 * np.arctan(800 / 1472)),
        (
            (
                lambda: 2 * np.arctan(800 / 1472),
                "This is the angle in radians; np.degrees converts it.",
            ),
            (
                lambda: np.degrees(np.arctan(800 / 1472)),
                "This is the angle from the centre to the edge: half of the field of view.",
            ),
            (
                lambda: np.degrees(np.arctan(1600 / 1472)),
                "The legs of the triangle are the focal length and HALF the image width.",
            ),
        ),
    ),
    "00.2": Exercise(
        "The unit of the cloud is the baseline. The distance between the cameras is 1.36 m. What "
        "is "
        "the depth in metres of a point with z = 8?",
        lambda: 8 * 1.36,
        (
            (
                lambda: 8 / 1.36,
                "One unit of the cloud is one baseline of 1.36 m, so eight units are more than "
                "eight "
                "metres.",
            ),
        ),
    ),
    "00.3": Exercise(
        "Which of these counts of a run is never larger than any of the others: 'keypoints', "
        "'matches', 'inliers', 'points'?",
        lambda: "points",
        (
            (
                lambda: "inliers",
                "Close: a point of the cloud is a triangulated inlier, and some inliers are "
                "omitted.",
            ),
            (
                lambda: "matches",
                "The estimation of the geometry rejects some of the matches.",
            ),
            (
                lambda: "keypoints",
                "Only some of the keypoints are matched.",
            ),
        ),
    ),
}
