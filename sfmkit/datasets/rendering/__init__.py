"""Rendered scenes with exact truth: surfaces, materials, textures, ray casting."""

from __future__ import annotations

from .raycasting import geometry, radiance, rays
from .scenes import SCENES, Pose, Scene

__all__ = ["SCENES", "Pose", "Scene", "geometry", "radiance", "rays"]
