"""Two reconstructions of partly the same images made one."""

from bundle.merging.merge_models import merge
from bundle.merging.merge_result import Merge

__all__ = ["Merge", "merge"]
