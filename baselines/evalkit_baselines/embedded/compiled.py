"""Access to the compiled core. Without it every use raises NotInstalled; there is no substitute in Python."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from evalkit.core.errors import NotInstalled
from evalkit.core.se2 import Floats

Precision = Literal["double", "float"]
Reals = NDArray[np.floating]

MODULES: dict[Precision, str] = {"double": "_core64", "float": "_core32"}


def compiled_missing() -> str:
    """Return why the core is missing and how to build it, or ""; does not load it."""
    package = __name__.rpartition(".")[0]
    if all(find_spec(f"{package}.{name}") for name in MODULES.values()):
        return ""
    return f"not installed: the compiled core was not built (needs a C and a C++ compiler): {_remedy()}"


def load_core(precision: Precision) -> ModuleType:
    """Import the core's module of a precision; raises NotInstalled where it cannot be loaded."""
    try:
        if precision == "double":
            from evalkit_baselines.embedded import _core64 as found  # noqa: PLC0415 - may be absent
        else:
            from evalkit_baselines.embedded import _core32 as found  # type: ignore[no-redef]  # noqa: PLC0415 - likewise
    except ImportError as error:
        raise NotInstalled("embedded", f"does not load ({error})", compiled_missing() or _remedy()) from error
    return found


def to_real(values: Floats, module: ModuleType) -> Reals:
    """Return the numbers as a contiguous array in the core's precision, without a copy where possible."""
    if values.dtype == module.REAL and values.flags.c_contiguous:
        return values
    with np.errstate(over="ignore"):  # too large for a float: the core rejects infinity
        return np.ascontiguousarray(values, dtype=module.REAL)


def _remedy() -> str:
    """Return the command that builds the core from this checkout; of a package, from the checkout it came from."""
    root = Path(__file__).resolve().parents[3]
    checkout = (root / "pyproject.toml").exists()
    where = f"--editable '{root}'" if checkout else "."
    command = f"apt-get install -y gcc g++ && pip install --force-reinstall --no-deps {where}"
    return command if checkout else f"{command} (in a checkout of evalkit)"
