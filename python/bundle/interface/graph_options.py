"""Options of a solve of a factor graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from bundle.interface.option_class import documented
from bundle.interface.option_fields import option
from bundle.interface.options import TRUST_REGION_STRATEGIES, SolveOptions

__all__ = ["GraphOptions"]


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class GraphOptions(SolveOptions):
    """Options of :meth:`bundle.FactorGraph.solve`: the SolveOptions, and Gauss-Newton.

    Raises:
        InputError: an option has a value outside its range; the message names option and value.
    """

    trust_region_strategy_type: str = option(
        "levenberg_marquardt",
        "--trust-region",
        "trust region strategy; gauss_newton is levenberg_marquardt that starts without damping",
        choices=("gauss_newton", *TRUST_REGION_STRATEGIES),
    )

    @classmethod
    def of(cls, options: SolveOptions | None, changes: Mapping[str, Any], caller: str) -> Self:
        """Return the options with some changed; ``options`` may also be plain SolveOptions."""
        if isinstance(options, SolveOptions) and not isinstance(options, cls):
            options = cls(**options.asdict())
        return super().of(options, changes, caller)
