"""Colours of operators, the same in plots, recordings and reports."""

from __future__ import annotations

from zlib import crc32

# Palette of Okabe and Ito (2008), distinguishable with all kinds of colour vision. Black is
# reserved for text, and yellow is not visible on white paper. Further operators have the "muted"
# colours of Tol (2021).
_ORANGE, _SKY, _GREEN, _BLUE, _RED, _PURPLE = (
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
)
_NAMED = {
    "surf": _RED,
    "orb": _BLUE,
    "fast-brief": _GREEN,
    "sift": _PURPLE,
    "akaze": _ORANGE,
    "kaze": _SKY,
    "brisk": "#882255",
    "rootsift": "#AA4499",
    "harris-brief": "#999933",
    "gftt-brief": "#44AA99",
    "xfeat": "#332288",
    "multi": "#444444",
}
_REST = ("#117733", "#88CCEE", "#DDCC77", "#CC6677", "#661100", "#6699CC")


def operator_colour(name: str) -> str:
    """Return ``#rrggbb`` of an operator; a colour outside the table depends on the name."""
    return _NAMED.get(name) or _REST[crc32(name.encode()) % len(_REST)]


def operator_rgb(name: str) -> tuple[int, int, int]:
    """Return the colour of an operator as three bytes."""
    c = operator_colour(name)
    return int(c[1:3], 16), int(c[3:5], 16), int(c[5:7], 16)
