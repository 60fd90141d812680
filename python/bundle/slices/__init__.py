"""Bundle adjustment of files that no process of mpirun holds as a whole: BAL, for now.

Each process reads the file as a stream and keeps the points that are its own (``bundle.ranks``
says which), with their observations (``slice_reading``); the solve is that of ``bundle.ranks``;
errors are measured where the observations are (``divided_errors``); the first process collects the
points and writes them beside the observations, which it copies from file to file
(``bal_refinement``).
"""
