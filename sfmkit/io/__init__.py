"""Files: photographs with EXIF, cameras, PLY clouds, COLMAP models."""
