"""`bundle refine FILE -o OUTPUT` for BAL files, written against pycolmap by who knows both.

Arguments: INPUT and OUTPUT (BAL files), then threads, iterations and the three tolerances. Prints
nothing. `pycolmap_model` is the same for COLMAP models.
"""

from __future__ import annotations

import sys
from pathlib import Path

from benchmarks import bal
from benchmarks.runners import protocol, pycolmap_


def main() -> None:
    """Load, adjust and save."""
    path, output = Path(sys.argv[1]), Path(sys.argv[2])
    request = protocol.Request(
        path=path,
        kind="bal",
        solver="auto",
        backend="",
        memory_limit=0,
        threads=int(sys.argv[3]),
        max_num_iterations=int(sys.argv[4]),
        function_tolerance=float(sys.argv[5]),
        gradient_tolerance=float(sys.argv[6]),
        parameter_tolerance=float(sys.argv[7]),
    )
    protocol.pin(request.threads)
    chosen = pycolmap_.options(request)
    problem = bal.read(path)
    reconstruction = pycolmap_.to_reconstruction(problem)
    pycolmap_.adjuster(reconstruction, chosen, "UNSPECIFIED").solve()
    bal.write(pycolmap_.to_bal(reconstruction, problem), output)


if __name__ == "__main__":
    main()
