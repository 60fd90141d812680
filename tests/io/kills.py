"""A process that kills itself before the n-th operation on the file system."""

import itertools
import os
import signal
import sys
from collections.abc import Callable

from bundle.io.atomic import replacement

OPERATIONS = (
    "chmod", "chown", "fsync", "link", "mkdir", "open", "rename", "replace", "rmdir", "unlink",
    "utime",
)  # fmt: skip


def killed_before(operation: int, work: Callable[[], None]) -> bool:
    """Do the work in a child; return whether it was killed before it had done it all."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        count = itertools.count()  # for all threads

        def counted(call):
            def kill_or_call(*arguments, **settings):
                if next(count) == operation:
                    os.kill(os.getpid(), signal.SIGKILL)
                return call(*arguments, **settings)

            return kill_or_call

        os.fsync = lambda _: None  # it takes long, and no kill can tell
        for name in OPERATIONS:
            setattr(os, name, counted(getattr(os, name)))
        replacement._exchange = counted(replacement._exchange)
        try:
            work()
            os._exit(0)
        finally:
            os._exit(1)
    status = os.waitpid(child, 0)[1]
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0, "the work has failed"
    return os.WIFSIGNALED(status)
