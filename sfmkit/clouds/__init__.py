"""Point clouds: density, local shape, alignment and comparison."""

__all__ = ["alignment", "comparison", "density", "local_shape"]
