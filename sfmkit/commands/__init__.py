"""Commands of ``sfmkit`` that are kept apart from the main one."""
