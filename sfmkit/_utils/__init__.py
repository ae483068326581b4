"""Helpers without knowledge of the field: threads, atomic writing, versions, progress."""
