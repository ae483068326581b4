"""The report of an ablation: statistics, tables, figures, page."""
