"""COLMAP models: ``cameras``, ``images`` and ``points3D`` as text or binary files."""

from .cameras import ColmapCamera, read_camera_list
from .files import model_suffix, read_colmap, write_colmap
from .model import ColmapImage, ColmapModel, ColmapPoint, image_path
from .text_files import TextFile

__all__ = [
    "ColmapCamera",
    "ColmapImage",
    "ColmapModel",
    "ColmapPoint",
    "TextFile",
    "image_path",
    "model_suffix",
    "read_camera_list",
    "read_colmap",
    "write_colmap",
]
