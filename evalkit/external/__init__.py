"""External back ends: a shared library, a program, or a file with poses or a map computed elsewhere."""

from pathlib import Path

INCLUDE = Path(__file__).parent
"""The folder of ``evalkit_backend.h``, for the compiler's ``-I``."""
