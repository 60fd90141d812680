"""`bundle` and `python -m bundle`. Slow imports happen after the memory check and in ``run``."""

import sys

from bundle.cli import startup


def run() -> int:
    """Run the command that the process was started with; return its exit code."""
    startup.begin()
    from bundle.base import own_process

    try:
        own_process.require_memory("bundle with its libraries", own_process.LIBRARIES)
    except MemoryError as error:
        sys.stderr.write(f"error: not enough memory: {error}\n")
        return 2
    own_process.load_core()
    from bundle.solving.ranks import launch

    launch.begin()
    from bundle.cli.main import main
    from bundle.solving.ranks.launch import size_by_launcher

    if size_by_launcher() == 1:
        startup.exit_code = main()
        return startup.exit_code
    from bundle.cli.many_processes import run_command

    return run_command(main)


if __name__ == "__main__":
    sys.exit(run())
