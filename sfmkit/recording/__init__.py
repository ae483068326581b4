"""Rerun recordings: log, read, view and inspect. No other package imports rerun."""

from .blueprint import PAGES, Layout, default_blueprint, layout_of, make_blueprint
from .log import (
    log_account,
    log_fusion,
    log_legend,
    log_reconstruction,
    log_run,
    log_timings,
    save_recording,
)
from .log_cloud import log_cloud, log_rays, log_residuals, log_uncertainty
from .log_geometry import log_epipolar_lines, log_homography, log_motion, log_pose
from .log_photos import log_correspondences, log_keypoints, log_matches, log_photographs
from .log_steps import log_ransac, log_refinement, log_runs
from .pages import RunPage, save_pages
from .read import Recording, RecordingError, read_recording
from .stream import STAGES, merge_recordings, new_stream, recording_ids, write_stream

__all__ = [
    "PAGES",
    "STAGES",
    "Layout",
    "Recording",
    "RecordingError",
    "RunPage",
    "default_blueprint",
    "layout_of",
    "log_account",
    "log_cloud",
    "log_correspondences",
    "log_epipolar_lines",
    "log_fusion",
    "log_homography",
    "log_keypoints",
    "log_legend",
    "log_matches",
    "log_motion",
    "log_photographs",
    "log_pose",
    "log_ransac",
    "log_rays",
    "log_reconstruction",
    "log_refinement",
    "log_residuals",
    "log_run",
    "log_runs",
    "log_timings",
    "log_uncertainty",
    "make_blueprint",
    "merge_recordings",
    "new_stream",
    "read_recording",
    "recording_ids",
    "save_pages",
    "save_recording",
    "write_stream",
]
