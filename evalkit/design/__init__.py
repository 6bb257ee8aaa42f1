"""Designed experiments, the base of ``evalkit study`` and ``evalkit tune``: factors, designs, points run and scored."""
