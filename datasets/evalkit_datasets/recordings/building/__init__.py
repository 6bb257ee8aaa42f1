"""Build recordings on the user's machine from published files that may not be redistributed."""
