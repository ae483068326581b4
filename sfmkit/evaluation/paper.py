"""Numbers of the paper, for comparison.

Dippold & Tsai, "Two-View Structure-from-Motion with Multiple Feature Detector Operators", Tables 2
to 5.
"""

from __future__ import annotations

# operator -> sequence -> (average RMSE of H, average number of features)
OXFORD: dict[str, dict[str, tuple[float, int]]] = {
    "multi": {
        "bark": (6.55, 2700),
        "boat": (5.96, 5140),
        "bikes": (0.36, 17_907),
        "trees": (0.52, 17_601),
        "graf": (11.57, 3032),
        "wall": (2.62, 18_443),
        "leuven": (0.37, 10_840),
        "ubc": (0.11, 15_901),
    },
    "surf": {
        "bark": (0.26, 1003),
        "boat": (0.14, 2191),
        "bikes": (0.30, 3462),
        "trees": (0.74, 2481),
        "graf": (8.18, 1675),
        "wall": (14.95, 3335),
        "leuven": (0.37, 3760),
        "ubc": (0.062, 3681),
    },
    "orb": {
        "bark": (16.10, 124),
        "boat": (55.10, 224),
        "bikes": (0.94, 281),
        "trees": (0.52, 179),
        "graf": (14.84, 168),
        "wall": (19.09, 137),
        "leuven": (0.40, 891),
        "ubc": (0.13, 387),
    },
    "fast-brief": {
        "bark": (49.92, 1573),
        "boat": (27.49, 2726),
        "bikes": (0.86, 4164),
        "trees": (0.60, 14_941),
        "graf": (27.88, 1189),
        "wall": (6.27, 14_970),
        "leuven": (0.38, 6189),
        "ubc": (0.09, 11_833),
    },
}

# Table -> its two sequences; figures 7 to 10 show the same results per pair.
OXFORD_TABLES = {
    2: ("bark", "boat"),
    3: ("bikes", "trees"),
    4: ("graf", "wall"),
    5: ("leuven", "ubc"),
}
OXFORD_FIGURES = {
    7: ("bark", "boat"),
    8: ("bikes", "trees"),
    9: ("graf", "wall"),
    10: ("leuven", "ubc"),
}

# Table 6, fountain: operator -> (initial, points, loss in per cent). The points of the single
# operators add up to 26,725, not to the 27,673 of the fusion, so they were estimated alone.
FOUNTAIN: dict[str, tuple[int, int, float]] = {
    "surf": (18_763, 14_093, 24.89),
    "orb": (12_980, 10_266, 20.91),
    "fast-brief": (3284, 2366, 27.95),
    "multi": (35_027, 27_673, 21.0),
}

# Tables 7 and 8, drone: (images, minutes, initial points, points of the antenna) of the paper's own
# method and of MicMac. The paper gives no times for the small shift. It gives 0.15 minutes as "less
# than" in the text and as ">0.15" in the table.
UAV: dict[str, dict[str, tuple[int, float | None, int, int]]] = {
    "small shift": {"this study": (2, None, 75_496, 4378), "MicMac": (31, None, 99_302, 7803)},
    "wide baseline": {
        "this study": (2, 0.15, 30_106, 9666),
        "MicMac": (93, 202.0, 409_261, 203_122),
    },
}
