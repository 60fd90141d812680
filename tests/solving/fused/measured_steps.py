"""Which step norms Ceres reports."""

import numpy as np

from bundle import _core


def first_measured(iterations):
    """The first iteration whose ``step_norm`` is Ceres' measure of the step.

    Ceres 2.2 reports 0 up to and with the first step that succeeds.
    """
    version = tuple(int(part) for part in _core.CERES_VERSION.split(".")[:2])
    if version < (2, 2):
        return 0
    return 2 + int(np.argmax(iterations["step_is_successful"][1:]))
