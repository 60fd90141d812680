"""What `bundle refine INPUT -o OUTPUT` does, written against pycolmap by someone who knows both.

Arguments: INPUT (BAL file or COLMAP folder), OUTPUT (of the same format), then threads, iterations
and the three tolerances. Prints nothing.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pycolmap

from benchmarks import bal
from benchmarks.runners import protocol, pycolmap_


def main() -> None:
    """Load, adjust and save."""
    path, output = Path(sys.argv[1]), Path(sys.argv[2])
    request = protocol.Request(
        path=path,
        kind="colmap" if path.is_dir() else "bal",
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
    if request.kind == "colmap":
        reconstruction = pycolmap.Reconstruction(path)
        pycolmap_.adjuster(reconstruction, chosen, "TWO_CAMS_FROM_WORLD").solve()
        reconstruction.update_point_3d_errors()
        output.mkdir()
        reconstruction.write_binary(output)
    else:
        problem = bal.read(path)
        reconstruction = pycolmap_.to_reconstruction(problem)
        pycolmap_.adjuster(reconstruction, chosen, "UNSPECIFIED").solve()
        bal.write(pycolmap_.to_bal(reconstruction, problem), output)


if __name__ == "__main__":
    main()
