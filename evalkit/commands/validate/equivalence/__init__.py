"""Comparison of two implementations, question by question: equal or not, and where and why they first differ."""
