"""The version of sfmkit, in one place."""

__version__ = "0.2.0"
