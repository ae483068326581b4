"""Point clouds: density, local shape, alignment, comparison."""

__all__ = ["alignment", "comparison", "density", "local_shape"]
