"""Reports on pose graphs for programs."""

from __future__ import annotations

import dataclasses
from typing import Any

from bundle._core import __version__
from bundle.errors import InputError
from bundle.graphs.pose_graphs.information import bad_information, describe_information
from bundle.graphs.pose_graphs.pose_graph_result import PoseGraphResult
from bundle.graphs.pose_graphs.solve_pose_graph import pose_graph_chi2
from bundle.interface.pose_graph_options import POSE_ERRORS
from bundle.model.pose_graph_arrays import PoseGraph
from bundle.reports.terminal.json import SCHEMA, plain, records
from bundle.reports.terminal.timing import WallTime

__all__ = [
    "conversion_of_graph",
    "heading_of_graph",
    "information_of_graph",
    "refinement_of_graph",
]

MOST_BAD = 10
"""Edges with bad information that are listed."""


def heading_of_graph(command: str, path: str, graph: PoseGraph) -> dict[str, Any]:
    """Return what every report on a pose graph begins with."""
    return {
        "schema": SCHEMA,
        "command": command,
        "version": __version__,
        "input": {
            "path": path,
            "format": "g2o",
            "dimension": graph.dimension,
            "num_poses": graph.num_poses,
            "num_edges": graph.num_edges,
            "num_closures": int(graph.is_closure.sum()),
            "num_fixed_poses": int(graph.fixed.sum()),
            "has_poses": graph.has_poses,
            "notes": list(graph.notes),
        },
    }


def refinement_of_graph(
    path: str, solved: PoseGraphResult, wall: WallTime, output: dict[str, str] | None
) -> dict[str, Any]:
    """Return the report of `bundle refine`; `output` is None where nothing was written."""
    options, graph = solved.options.asdict(), solved.problem
    for field in dataclasses.fields(solved.options):
        if field.metadata["choices"] is not None:
            options[field.name] = options[field.name].upper()
    return {
        **heading_of_graph("refine", path, solved.initial_problem),
        "options": plain(options),
        "summary": plain(dataclasses.asdict(solved.summary)),
        "iterations": plain(records(solved.iterations)),
        "rejected_edges": [
            {
                "edge": graph.ids[graph.edges[edge]].tolist(),
                "line": int(graph.edge_lines[edge]) or None,
                "chi2": float(solved.chi2_after[edge]),
                "weight": float(solved.weights[edge]),
            }
            for edge in solved.rejected
        ],
        "left_out_edges": [
            {
                "edge": graph.ids[graph.edges[entry.edge]].tolist(),
                "line": int(graph.edge_lines[entry.edge]) or None,
                "pair_chi2": plain(entry.chi2),
                "num_contradicted": entry.num_contradicted,
                "chi2": float(solved.chi2_after[entry.edge]),
            }
            for entry in solved.left_out
        ],
        "wall_time": plain(dataclasses.asdict(wall)),
        "output": output,
    }


def information_of_graph(path: str, graph: PoseGraph) -> dict[str, Any]:
    """Return the report of `bundle info`: counts, components, chi2 now, what is wrong."""
    bad = bad_information(graph)
    chi2: dict[str, float | None] = dict.fromkeys(POSE_ERRORS)
    for error in chi2:
        try:
            chi2[error] = float(pose_graph_chi2(graph, error).sum())
        except InputError:  # of information matrices that are none, which are listed
            break
    degrees = graph.tangent_size * (graph.num_edges - graph.num_poses + graph.num_components)
    return {
        **heading_of_graph("info", path, graph),
        "num_components": graph.num_components,
        "chi2": plain(chi2),
        "degrees_of_freedom": degrees,
        "num_bad_information": len(bad),
        "bad_information": [
            {
                "edge": graph.ids[graph.edges[edge]].tolist(),
                "line": int(graph.edge_lines[edge]) or None,
                "sentence": f"{graph.edge_name(edge)}: information: "
                f"{describe_information(graph, edge)}",
            }
            for edge in bad[:MOST_BAD]
        ],
    }


def conversion_of_graph(
    path: str, graph: PoseGraph, output: dict[str, str], lost: tuple[str, ...]
) -> dict[str, Any]:
    """Return the report of `bundle convert`."""
    return {
        **heading_of_graph("convert", path, graph),
        "output": output,
        "lost": list(lost),
    }
