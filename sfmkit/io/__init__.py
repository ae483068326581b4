"""Files: photographs with EXIF, cameras, PLY clouds, COLMAP models.

Import the modules directly: reading a cloud needs neither Pillow nor the camera formats.
"""

__all__ = [
    "calibration",
    "cameras",
    "colmap",
    "exif",
    "header",
    "images",
    "intrinsics",
    "jpeg",
    "pixels",
    "ply",
    "ply_header",
    "sensors",
    "truth",
]
