"""Bundle adjustment of models that no process of mpirun holds as a whole: BAL, COLMAP in binary.

Each process reads the files as streams and keeps the points that are its own (``bundle.ranks`` says
which), with their observations (``slice_reading``); the solve is that of ``bundle.ranks``; errors
are measured where the observations are (``divided_errors``); the first process collects the points
and writes them beside the observations, which it copies from file to file
(``sliced_refinement``).
"""
