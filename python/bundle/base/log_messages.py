"""Messages to the logger "bundle" of the standard library's logging.

A program shows them with its own handlers::

    import logging
    logging.basicConfig(level=logging.INFO)

Levels: DEBUG for each iteration, INFO for the start and the end of a solve, WARNING for warnings.
The command line shows the same information in its own way and logs nothing.

Importing logging is slow. A program that has not imported it has no handler, so that no message can
be shown: then nothing is logged.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any

NAME = "bundle"
LEVELS = {"debug": 10, "info": 20, "warning": 30}
"""Levels of logging by name."""


def log(level: str, message: str, *values: object) -> None:
    """Log a message with values in the style of logging, such as ``log("info", "%d steps", 3)``.

    A value that is slow to make can be a function, which is called if a handler shows the message.
    """
    logger = _logger()
    if logger is not None and logger.isEnabledFor(LEVELS[level]):
        shown = (value() if callable(value) else value for value in values)
        logger.log(LEVELS[level], message, *shown)


def logged_iterations(
    progress: Callable[[dict[str, Any]], None] | None,
) -> Callable[[dict[str, Any]], None] | None:
    """Return a progress function that also logs each iteration; the same one if nobody listens."""
    logger = _logger()
    if logger is None or not logger.isEnabledFor(LEVELS["debug"]):
        return progress

    def step(iteration: Mapping[str, Any]) -> None:
        log("debug", "iteration %d: cost %.9e", iteration["iteration"], iteration["cost"])
        if progress is not None:
            progress(dict(iteration))

    return step


def _logger() -> Any:
    """Return the logger; None if the program has not imported logging."""
    logging = sys.modules.get("logging")
    if logging is None:
        return None
    logger = logging.getLogger(NAME)
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())  # no output without the program's handlers
    return logger
