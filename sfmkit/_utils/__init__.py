"""General helpers: threads, atomic writing, versions, progress."""
