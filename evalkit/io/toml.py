"""Read TOML with bounds on nesting, key length and number size."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from evalkit.core.errors import BadExperiment

_LONG_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){100}""")


def load_toml(path: Path, expected: str) -> dict[str, Any]:
    """Return the tables of a configuration file; ``expected``: what it should be, for errors ("a study").

    Raises BadExperiment if the file does not exist, cannot be read, or is not valid TOML.
    """
    try:
        return parse_toml(path.read_text(encoding="utf-8-sig"))  # some editors begin a file with a mark
    except FileNotFoundError:
        raise BadExperiment(str(path), "", f"no such file; give the path of {expected}") from None
    except UnicodeDecodeError as error:
        raise BadExperiment(str(path), "", f"not UTF-8 text at byte {error.start}; save it as UTF-8") from error
    except OSError as error:
        raise BadExperiment(str(path), "", f"cannot be read ({error.strerror or error})") from error
    except ValueError as error:
        raise BadExperiment(str(path), "", f"not valid TOML: {error}") from error


def parse_toml(text: str, parse_number: Callable[[str], Any] = float) -> dict[str, Any]:
    """Return the tables of a TOML text; ``parse_number`` converts numbers with a decimal point.

    Raises ValueError for invalid TOML, and for text that would take far more time or memory than its size suggests:
    keys of 100 parts, deep nesting, integers beyond 64 bits.
    """
    if _LONG_KEY.search(text):
        raise ValueError("a key of 100 or more parts")
    try:
        content = tomllib.loads(text, parse_float=parse_number)
    except RecursionError:
        raise ValueError("tables or lists nested too deeply") from None
    except ArithmeticError:
        raise ValueError("a number out of range") from None
    _refuse_long_integers(content)
    return content


def _refuse_long_integers(content: dict[str, Any]) -> None:
    """Raise ValueError for an integer beyond the 64 bits of TOML: longer ones cannot even be printed."""
    waiting: list[Any] = [content]
    while waiting:
        value = waiting.pop()
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise ValueError("an integer of more than 64 bits")
        if isinstance(value, (dict, list)):
            waiting.extend(value.values() if isinstance(value, dict) else value)
