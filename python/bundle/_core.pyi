"""Types of the C++ core, one section a binding file."""

from bundle.problem import Problem

__version__: str

class InputError(ValueError): ...

# bind_problem.cpp
def validate(problem: Problem) -> None: ...

# bind_cameras.cpp

# bind_bal.cpp

# bind_colmap.cpp
def is_colmap_model(folder: str | bytes) -> bool: ...
def check_colmap_model(folder: str | bytes) -> tuple[bool, dict[int, str]]: ...

# bind_solve.cpp
