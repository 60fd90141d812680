"""Load the NUL-separated paths on standard input and print one JSON line for each.

Run by mutations.py: `load_driver.py SECONDS_PER_FILE`. What the library prints while loading, from
Python or from C++, is caught and reported with the path.
"""

import faulthandler
import json
import os
import resource
import sys
import tempfile
import warnings

import bundle
from bundle.io.atomic.replaced_paths import NoteWarning

GIGABYTE = 2**30


def main() -> None:
    timeout = float(sys.argv[1])
    # A corrupt count must not become an allocation: beyond this, the process fails visibly.
    resource.setrlimit(resource.RLIMIT_AS, (6 * GIGABYTE, 6 * GIGABYTE))
    verdicts = os.fdopen(os.dup(1), "w")
    crashes = os.fdopen(os.dup(2), "w")
    faulthandler.enable(crashes)
    with tempfile.TemporaryFile() as printed:
        os.dup2(printed.fileno(), 1)
        os.dup2(printed.fileno(), 2)
        for path in sys.stdin.buffer.read().split(b"\0")[:-1]:
            faulthandler.dump_traceback_later(timeout, exit=True, file=crashes)
            kind, message = attempt(os.fsdecode(path))
            faulthandler.cancel_dump_traceback_later()
            sys.stdout.flush()
            sys.stderr.flush()
            printed.seek(0)
            if stray := printed.read():
                kind, message = "printed", stray.decode(errors="backslashreplace")
                printed.seek(0)
                printed.truncate()
            print(json.dumps([kind, message]), file=verdicts, flush=True)


def attempt(path: str) -> tuple[str, str]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NoteWarning)  # what a reader says of a model it takes
            bundle.load(path)
    except bundle.InputError as error:
        return "InputError", str(error)
    except OSError as error:
        return "OSError", str(error)
    except BaseException as error:
        return type(error).__name__, str(error)
    return "loaded", ""


if __name__ == "__main__":
    main()
