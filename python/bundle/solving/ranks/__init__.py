"""Solves that are divided among the processes that mpirun starts.

The first process (rank 0) runs the command as if it were the only process. At a solve it sends each
other rank a part of the points (``partition``). All ranks then run the core's solver, which
communicates by sums and broadcasts (``mpi_ranks``). At the end, rank 0 collects the points
(``divided_solve``). ``launch`` returns the number of processes without importing mpi4py.
"""
