"""Everything a report states, computed once from the results."""
