"""Values and text of the JSON files that commands write."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any


def replace_non_finite(value: Any) -> Any:
    """Return a value as JSON has it: lists, texts as keys, None for a number that is not finite."""
    if isinstance(value, Mapping):
        return {str(key): replace_non_finite(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [replace_non_finite(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def indent_json(content: Any) -> str:
    """Return the text of a JSON file, a value a line."""
    return json.dumps(content, indent=1) + "\n"
