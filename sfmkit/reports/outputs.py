"""A reconstruction as a folder of files, written whole or not at all."""

from __future__ import annotations

import json
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from .._utils.writing import staged_folder
from ..io.colmap import write_colmap
from ..io.ply import write_ply
from ..pipeline.reconstruction import Reconstruction
from ..pipeline.report import make_report
from ..pipeline.stages import name_of


def write_outputs(
    result: Reconstruction,
    folder: str | Path,
    *,
    overwrite: bool = False,
    colmap: bool = False,
    recording: bool = True,
    pictures: bool = True,
) -> dict:
    """Write ``report.json``, ``matches.npz`` and, where there is a cloud, ``cloud.ply``; see
    docs/outputs.md.

    Args:
        folder: made new; an existing one is kept and refused unless `overwrite`.
        colmap: also a COLMAP text model in ``colmap/``.
        recording: also ``recording.rrd`` for the Rerun viewer.
        pictures: also ``matches.png`` and ``cloud.png``.

    Returns:
        The report as written.

    Raises:
        OutputError: the folder exists or cannot be written. Whatever was there before is untouched.
    """
    began = time.perf_counter()
    report: dict = {}
    with staged_folder(Path(folder), overwrite=overwrite) as staged, ThreadPoolExecutor(1) as other:
        # The recording takes as long as everything else, and is written at the same time.
        recorded = other.submit(_record, staged, result) if recording else None
        np.savez(staged / "matches.npz", **match_arrays(result))  # type: ignore[arg-type]
        if result.cloud is not None:
            write_ply(staged / "cloud.ply", result.cloud)
        if colmap and result.cloud is not None:
            write_colmap(
                staged / "colmap",
                result.two_view,
                result.correspondences,
                result.cloud,
                (name_of(result.images[0], 1), name_of(result.images[1], 2)),
            )
        if pictures:
            from ..viz.figures import cloud_picture, match_picture, save

            save(match_picture(result), staged / "matches.png")
            if result.cloud is not None and len(result.cloud):
                save(cloud_picture(result.cloud), staged / "cloud.png")
        if recorded is not None:
            recorded.result()
        report = make_report(result)
        seconds = time.perf_counter() - began
        report["timings_s"]["write"] = round(seconds, 4)
        report["timings_s"]["total"] = round(report["timings_s"]["total"] + seconds, 4)
        (staged / "report.json").write_text(json.dumps(report, indent=1) + "\n")
    return report


def _record(folder: Path, result: Reconstruction) -> None:
    from ..recording.log import save_recording

    save_recording(folder / "recording.rrd", result)


def match_arrays(result: Reconstruction) -> dict[str, np.ndarray]:
    """What ``matches.npz`` holds: the fused correspondences with their fate. No pickle: strings are
    fixed-width."""
    corr = result.correspondences
    point = np.full(len(corr), -1, dtype=np.int64)
    if result.cloud is not None:
        point[result.cloud.match.numpy()] = np.arange(len(result.cloud))
    arrays = {
        "x1": corr.x1.numpy(),
        "x2": corr.x2.numpy(),
        "distance": corr.distance.numpy(),
        "ratio": corr.ratio.numpy(),
        "operator_id": corr.operator_id.numpy(),
        "operator_mask": corr.operator_mask.numpy(),
        "index1": corr.index1.numpy(),
        "index2": corr.index2.numpy(),
        "operators": np.array(corr.operators),
        "inlier": result.two_view.inliers.numpy(),
        "point": point,
    }
    if result.cloud is not None and result.cloud.covariance is not None:
        arrays["covariance"] = result.cloud.covariance.numpy()
    return arrays
