"""Suite of the project: `pytest` in this folder."""

import numpy as np
from landmarks import RangeBearing, make_graph


def test_jacobians(check_gradients):
    """One line: the fixture fails with the name of the mistake."""
    check_gradients(RangeBearing(3.0, 0.2), [[1, 2, 0.3], [4, 5]], ["se2", None], tangent="gtsam")


def test_map():
    """With --bundle-gradients (pyproject.toml), each solve checks its factors first."""
    result = make_graph().solve()
    np.testing.assert_allclose(result.values["l1"], [4, 4], atol=0.3)
