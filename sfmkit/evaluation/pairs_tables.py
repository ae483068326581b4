"""Tables of the benchmark of pairs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from ..datasets.pair import HOMOGRAPHY, TWO_VIEW
from ..metrics import error_auc, trapezoidal_auc
from ..reports.result import Cell, Column, Result, ResultTable
from .pairs import FAILED, RESULT, pose_error
from .rows import Row

__all__ = ["pairs_result"]

AUC_DEG = (1.0, 5.0, 10.0, 20.0)
SOLVED_DEG = (5.0, 10.0)
AUC_PX = (1.0, 3.0, 5.0, 10.0)
MMA_PX = (1, 2, 3, 5, 10)
STAGES = ("detect", "match", "fuse", "estimate", "refine", "triangulate")


def pairs_result(rows: Sequence[Row], command: str, name: str = "pairs") -> Result:
    """Make the tables of the rows.

    Args:
        rows: Rows of :func:`sfmkit.evaluation.pairs.bench_pairs`.
        command: Command that reproduces them.
        name: Name of the benchmark.
    """
    results = [row for row in rows if row["kind"] == RESULT]
    poses = [row for row in results if row["problem"] == TWO_VIEW]
    planes = [row for row in results if row["problem"] == HOMOGRAPHY]
    failed = [row for row in rows if row["kind"] == FAILED]
    tables: list[ResultTable] = []
    if poses:
        tables.append(_pose_table(poses, failed))
        if any(row["has_truth"] for row in poses):
            tables.append(_pose_areas(poses))
        tables.append(_pose_pairs(poses))
    if planes:
        tables.append(_homography_table(planes, failed))
        if any(row["has_truth"] for row in planes):
            tables.append(_homography_areas(planes))
        if any("mma" in row for row in planes):
            tables.append(_accuracy_table([row for row in planes if "mma" in row]))
        tables.append(_homography_pairs(planes))
    if results:
        tables.append(_seconds_table(results))
    if failed:
        tables.append(_failed_table(failed))
    datasets = ", ".join(dict.fromkeys(row["dataset"] for row in rows))
    count = len({row["digest"] for row in rows})
    return Result(
        name=name,
        title=f"Pairs of {datasets}: {count} {'pair' if count == 1 else 'pairs'}",
        command=command,
        tables=tuple(tables),
        seeds=tuple(sorted({row["seed"] for row in results})),
        notes=(
            "A pair counts once per seed. An estimate with the verdict too little evidence is "
            "refused: its errors are infinite, and it counts in the medians, shares and areas. "
            "Pairs that failed, for instance because an image cannot be read, are listed and not "
            "included in any other number.",
        ),
    )


def _by_operator(rows: Sequence[Row]) -> Iterable[tuple[str, list[Row]]]:
    for name in dict.fromkeys(row["operator"] for row in rows):
        yield name, [row for row in rows if row["operator"] == name]


def _by_pair(rows: Sequence[Row]) -> Iterable[list[Row]]:
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["digest"], row["operator"]), []).append(row)
    return groups.values()


def _errors(rows: Sequence[Row], field: str = "error") -> list[float]:
    """List the errors of the pairs with ground truth; infinity without an estimate."""
    return [math.inf if row[field] is None else row[field] for row in rows if row["has_truth"]]


def _median(values: Sequence[float | None]) -> float | None:
    """Return the median; None if there are no values or the median is infinite."""
    found = [value for value in values if value is not None]
    median = float(np.median(found)) if found else math.inf
    return median if math.isfinite(median) else None


def _share(errors: Sequence[float], limit: float) -> float | None:
    return float(np.mean(np.array(errors) <= limit)) if errors else None


def _folded_error(row: Row) -> float:
    """Return the larger of both errors, ignoring the sign of the translation."""
    rotation, translation = row["rotation_deg"], row["translation_deg"]
    if row["error"] is None or translation is None:
        return math.inf if row["error"] is None else row["error"]
    return pose_error(rotation, min(translation, 180 - translation))


def _pose_table(rows: Sequence[Row], failed: Sequence[Row]) -> ResultTable:
    lines: list[tuple[Cell, ...]] = []
    for name, mine in _by_operator(rows):
        errors = _errors(mine)
        moved = [r for r in mine if r["error"] is None or r["translation_deg"] is not None]
        lines.append(
            (
                name,
                len(mine),
                len(errors),
                sum(row["refused"] for row in mine),
                sum(row["operator"] == name and row["problem"] == TWO_VIEW for row in failed),
                _median(_errors(mine, "rotation_deg")),
                _median(_errors(moved, "translation_deg")),
                *(_share(errors, limit) for limit in SOLVED_DEG),
                _median([row["inliers"] for row in mine]),
                _median([row["points"] for row in mine]),
            )
        )
    columns = (
        Column("operator"),
        Column("estimates", ","),
        Column("with truth", ","),
        Column("refused", ","),
        Column("failed pairs", ","),
        Column("rotation error, degrees", ".2f"),
        Column("translation error, degrees", ".2f"),
        *(Column(f"solved within {limit:g} degrees", ".1%") for limit in SOLVED_DEG),
        Column("inliers", ",.0f"),
        Column("points", ",.0f"),
    )
    return ResultTable(
        "poses",
        "Two-view geometries",
        columns,
        tuple(lines),
        "Errors, inliers and points are medians; an empty cell stands for an infinite median. A "
        "pair is solved where rotation and translation error are both within the limit.",
    )


_MEAN, _TRAPEZOIDAL = "mean of max(0, 1 - e/T)", "trapezoidal AUC (SuperGlue)"


def _areas(
    rows: Sequence[Row],
    thresholds: Sequence[float],
    trapezoidal_error: Callable[[Row], float],
) -> tuple[tuple[Cell, ...], ...]:
    """List both areas under the recall curve for every operator."""
    lines: list[tuple[Cell, ...]] = []
    for name, mine in _by_operator(rows):
        if errors := _errors(mine):
            others = [trapezoidal_error(row) for row in mine if row["has_truth"]]
            lines.append((name, _MEAN, *error_auc(errors, thresholds)))
            lines.append((name, _TRAPEZOIDAL, *trapezoidal_auc(others, thresholds)))
    return tuple(lines)


def _area_columns(thresholds: Sequence[float], unit: str) -> tuple[Column, ...]:
    areas = (Column(f"T = {threshold:g} {unit}", ".3f") for threshold in thresholds)
    return (Column("operator"), Column("measure"), *areas)


def _pose_areas(rows: Sequence[Row]) -> ResultTable:
    return ResultTable(
        "auc",
        "Area under the recall curve of the pose error",
        _area_columns(AUC_DEG, "degrees"),
        _areas(rows, AUC_DEG, _folded_error),
        "e is the larger of rotation and translation error. The trapezoidal AUC, as in the "
        "evaluation of SuperGlue, joins the points of the recall curve by lines and ignores the "
        "sign of the translation; only compare values of the same measure.",
    )


def _homography_areas(rows: Sequence[Row]) -> ResultTable:
    return ResultTable(
        "homography-auc",
        "Area under the recall curve of the error of the homography",
        _area_columns(AUC_PX, "px"),
        _areas(rows, AUC_PX, lambda row: math.inf if row["error"] is None else row["error"]),
        "e is the mean distance of the four corners, or the error at the check points where there "
        "are some. The trapezoidal AUC joins the points of the recall curve by lines; only compare "
        "values of the same measure, and of images of the same size.",
    )


def _part(row: Row) -> str:
    """Return what changes in a sequence of HPatches; an empty text for other data."""
    if row["dataset"] != "hpatches":
        return ""
    return "illumination" if row["sequence"].startswith("i_") else "viewpoint"


def _accuracy_table(rows: Sequence[Row]) -> ResultTable:
    lines: list[tuple[Cell, ...]] = []
    for name, mine in _by_operator(rows):
        parts = dict.fromkeys(["all pairs", *filter(None, map(_part, mine))])
        for part in parts:
            chosen = [row for row in mine if part in ("all pairs", _part(row))]
            # every seed has the same matches
            once = list({row["digest"]: row for row in chosen}.values())
            accuracy = np.mean([row["mma"] for row in once], axis=0)
            matches = float(np.mean([row["mma_matches"] for row in once]))
            lines.append((name, part, len(once), matches, *(accuracy[t - 1] for t in MMA_PX)))
    columns = (
        Column("operator"),
        Column("pairs"),
        Column("number", ","),
        Column("matches", ",.0f"),
        *(Column(f"{threshold} px", ".1%") for threshold in MMA_PX),
    )
    return ResultTable(
        "matching-accuracy",
        "Mean matching accuracy",
        columns,
        tuple(lines),
        "The share of the matches within a distance of their true position, averaged over the "
        "pairs; a pair without matches counts as 0. The matches of all operators together are the "
        "fused ones.",
    )


def _pose_pairs(rows: Sequence[Row]) -> ResultTable:
    lines: list[tuple[Cell, ...]] = [
        (
            *(group[0][field] for field in ("dataset", "sequence", "pair", "operator")),
            ", ".join(dict.fromkeys(row["verdict"] for row in group)),
            _median([row["matches"] for row in group]),
            _median([row["inliers"] for row in group]),
            _median([row["points"] for row in group]),
            _median(_errors(group, "rotation_deg")),
            _median(_errors(group, "translation_deg")),
            _median([sum(row["seconds"].values()) for row in group]),
        )
        for group in _by_pair(rows)
    ]
    columns = (
        *map(Column, ("data set", "sequence", "pair", "operator", "verdict")),
        Column("matches", ",.0f"),
        Column("inliers", ",.0f"),
        Column("points", ",.0f"),
        Column("rotation error, degrees", ".3f"),
        Column("translation error, degrees", ".3f"),
        Column("seconds", ",.2f"),
    )
    return ResultTable(
        "pose-pairs",
        "Two-view geometries: every pair, medians over the seeds",
        columns,
        tuple(lines),
    )


def _homography_table(rows: Sequence[Row], failed: Sequence[Row]) -> ResultTable:
    lines: list[tuple[Cell, ...]] = []
    for name, mine in _by_operator(rows):
        errors = _errors(mine)
        lines.append(
            (
                name,
                len(mine),
                len(errors),
                sum(row["refused"] for row in mine),
                sum(row["operator"] == name and row["problem"] == HOMOGRAPHY for row in failed),
                _median([row["corner_error_px"] for row in mine]),
                _median([row["check_error_px"] for row in mine]),
                _median(errors),
                _median([row["inliers"] for row in mine]),
            )
        )
    columns = (
        Column("operator"),
        Column("estimates", ","),
        Column("with truth", ","),
        Column("refused", ","),
        Column("failed pairs", ","),
        Column("corner error, px", ",.2f"),
        Column("check-point error, px", ",.2f"),
        Column("error, px", ",.2f"),
        Column("inliers", ",.0f"),
    )
    return ResultTable(
        "homographies",
        "Homographies",
        columns,
        tuple(lines),
        "Corner and check-point errors are medians over the estimates that have one. The error e "
        "of a pair is the check-point error where there are check points, else the corner error, "
        "and infinite where there is no estimate.",
    )


def _homography_pairs(rows: Sequence[Row]) -> ResultTable:
    lines: list[tuple[Cell, ...]] = [
        (
            *(group[0][field] for field in ("dataset", "sequence", "pair", "operator")),
            ", ".join(dict.fromkeys(row["verdict"] for row in group)),
            _median([row["matches"] for row in group]),
            _median([row["inliers"] for row in group]),
            _median([row["corner_error_px"] for row in group]),
            _median([row["check_error_px"] for row in group]),
            _median([sum(row["seconds"].values()) for row in group]),
        )
        for group in _by_pair(rows)
    ]
    columns = (
        *map(Column, ("data set", "sequence", "pair", "operator", "verdict")),
        Column("matches", ",.0f"),
        Column("inliers", ",.0f"),
        Column("corner error, px", ",.2f"),
        Column("check-point error, px", ",.2f"),
        Column("seconds", ",.2f"),
    )
    return ResultTable(
        "homography-pairs",
        "Homographies: every pair, medians over the seeds",
        columns,
        tuple(lines),
    )


def _seconds_table(rows: Sequence[Row]) -> ResultTable:
    lines: list[tuple[Cell, ...]] = []
    for name, mine in _by_operator(rows):
        stages = [_median([row["seconds"].get(stage) for row in mine]) for stage in STAGES]
        total = _median([sum(row["seconds"].values()) for row in mine])
        lines.append((name, *stages, total))
    columns = (Column("operator"), *(Column(stage, ",.3f") for stage in (*STAGES, "total")))
    return ResultTable(
        "seconds",
        "Seconds per pair and stage, medians",
        columns,
        tuple(lines),
        "Detection and matching were run once per operator and pair; those of all operators "
        "together are sums. Reading the images is not included.",
    )


def _failed_table(rows: Sequence[Row]) -> ResultTable:
    fields = ("dataset", "sequence", "pair", "operator", "reason")
    return ResultTable(
        "failed",
        "Pairs that failed",
        tuple(map(Column, ("data set", "sequence", "pair", "operator", "reason"))),
        tuple(tuple(row[field] for field in fields) for row in rows),
    )
