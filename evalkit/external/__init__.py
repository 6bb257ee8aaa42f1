"""Somebody else's implementation as a method: a shared library, a program, or poses computed elsewhere."""

from pathlib import Path

INCLUDE = Path(__file__).parent
"""The folder of ``evalkit_backend.h``, for the compiler's ``-I``."""
