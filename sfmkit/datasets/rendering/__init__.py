"""Rendered scenes with exact truth: surfaces, materials, textures, ray casting."""
