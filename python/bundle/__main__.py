"""`python -m bundle` is `bundle`."""

import sys

from bundle.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
