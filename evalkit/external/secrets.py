"""Secrets in the command of a program: the results store the name of a variable, never its value."""

from __future__ import annotations

import os
import re

from evalkit.core.errors import BadParameter

SECRET_OPTION = re.compile(r"--?([\w-]*[-_])?(token|password|passwd|secret|api-?key)", re.IGNORECASE)
VARIABLE = re.compile(r"\$[A-Za-z_]\w*")


def fill_in_secrets(words: list[str]) -> list[str]:
    """Return the words with secrets from environment variables: ``--token=$NAME`` or ``--token $NAME``.

    The command line is stored with the results, so a secret itself is refused: raises BadParameter.
    """
    filled = list(words)
    for index, word in enumerate(words):
        option, equals, value = word.partition("=")
        if not SECRET_OPTION.fullmatch(option) or not (equals or index + 1 < len(words)):
            continue
        variable = value if equals else words[index + 1]
        if not VARIABLE.fullmatch(variable):
            expected = f"{option}{equals or ' '}$NAME, the name of an environment variable"
            raise BadParameter(f"exec:{words[0]}", option, "a secret, which the results would store", expected)
        secret = os.environ.get(variable[1:])
        if secret is None:
            raise BadParameter(f"exec:{words[0]}", option, variable, "an environment variable that is set")
        filled[index if equals else index + 1] = f"{option}={secret}" if equals else secret
    return filled
