"""`bundle --print-completion SHELL`: a script that completes commands, flags, values and paths.

shtab generates the script from the parser. The script is static, so a shell completes without
starting Python.
"""

from __future__ import annotations

import argparse
from typing import Any

from bundle.errors import InputError

SHELLS = ("bash", "zsh", "tcsh")


class PrintCompletion(argparse.Action):
    """Action that prints the completion script of a shell and exits."""

    def __call__(self, parser: Any, _namespace: Any, shell: Any, _flag: str | None = None) -> None:
        """Print the script.

        Raises:
            InputError: shtab is not installed.
        """
        # Only this flag needs these imports; shtab is an optional dependency.
        from bundle.cli.path_checks import PathArgument

        try:
            import shtab
        except ImportError:
            raise InputError(
                "--print-completion: expected the package shtab, which is not installed: pip "
                "install shtab"
            ) from None
        for command in parser.commands().values():
            for action in command._actions:
                if isinstance(action.type, PathArgument):
                    action.complete = shtab.FILE
        parser._print_message(shtab.complete(parser, shell=shell))
        parser.exit()
