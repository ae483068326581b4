"""Point clouds: density, local shape, alignment, comparison."""
