"""Render an analysis as one offline HTML page."""
