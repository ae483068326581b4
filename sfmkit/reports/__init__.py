"""Results as files: output folders, tables, HTML pages, LaTeX."""
