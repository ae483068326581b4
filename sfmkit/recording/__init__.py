"""Rerun recordings: log, read, inspect. No other package imports rerun."""
