"""Loops of drifted models: closed by a graph of images before bundle adjustment."""

from bundle.loops.loop_closing import LoopClosing, LoopClosure
from bundle.loops.loop_graph import close_loops

__all__ = ["LoopClosing", "LoopClosure", "close_loops"]
