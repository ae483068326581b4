"""Rendered scenes with exact ground truth: surfaces, materials, textures and ray casting."""

from __future__ import annotations

from .raycasting import geometry, radiance, rays
from .scenes import SCENES, Pose, Scene

__all__ = ["SCENES", "Pose", "Scene", "geometry", "radiance", "rays"]
