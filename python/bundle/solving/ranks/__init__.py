"""Solves that are divided among the processes that mpirun starts.

The first process (rank 0) runs the command as if it were alone. Where it comes to a solve it sends
each of the others its part of the points (``partition``); all of them then run the core's solver,
which meets the others by sums and broadcasts (``mpi_ranks``), and the first collects the points
(``divided_solve``). ``launch`` knows whether there are several processes at all, without mpi4py.
"""
