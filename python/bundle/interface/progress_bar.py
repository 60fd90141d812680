"""Progress bar of a solve: an adaptor of tqdm for the argument ``progress``."""

from __future__ import annotations

from typing import Any, Self

from bundle.base.optional_packages import require_package


class ProgressBar:
    """Progress function that shows the iterations of a solve with tqdm, also in notebooks.

    Example::

        with bundle.ProgressBar() as bar:
            bundle.solve(problem, progress=bar)

    Each solve of a run (the rounds of ``solve_rounds``, for example) has its own bar, which shows
    iterations, time, cost and gradient. Without ``with``, call ``close`` after the last solve.

    Args:
        **settings: arguments of ``tqdm.auto.tqdm``, such as ``desc`` or ``leave``. ``total`` is the
            expected number of iterations; by default it is unknown.

    Raises:
        InputError: tqdm is not installed (``pip install tqdm``).
    """

    def __init__(self, **settings: Any) -> None:
        require_package("tqdm", "tqdm", "ProgressBar")
        from tqdm.auto import tqdm

        self._tqdm = tqdm
        self._settings = {"desc": "solve", "unit": " iterations", **settings}
        self._bar: Any = None

    def __call__(self, iteration: dict[str, Any]) -> None:
        """Show an iteration, a dict with the keys of Ceres' IterationSummary."""
        number = int(iteration["iteration"])
        if self._bar is None or number < self._bar.n:  # another solve begins
            self.close()
            self._bar = self._tqdm(**self._settings)
        facts = f"cost {iteration['cost']:.6e}, gradient {iteration['gradient_max_norm']:.1e}"
        self._bar.set_postfix_str(facts, refresh=False)
        self._bar.update(number - self._bar.n)

    def close(self) -> None:
        """End the bar; a later solve begins another one."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()
