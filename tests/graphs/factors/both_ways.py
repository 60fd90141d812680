"""The same problem both ways: factor graphs of pose graphs and of bundle adjustment problems."""

import numpy as np

import bundle
from bundle.model.cameras import camera_models


def of_pose_graph(graph, name=int):
    """A FactorGraph with the keys ``name(id)``; the first pose fixed if no pose is."""
    found = bundle.FactorGraph()
    keys = [name(int(key)) for key in graph.ids]
    fixed = graph.fixed if graph.fixed.any() else np.arange(graph.num_poses) == 0
    for key, pose, held in zip(keys, graph.poses, fixed, strict=True):
        found.add_variable(key, pose, "se2" if graph.dimension == 2 else "se3", fixed=bool(held))
    for k, (a, b) in enumerate(graph.edges.tolist()):
        found.add_factor(
            bundle.BetweenFactor(keys[a], keys[b], graph.measurements[k], graph.information[k])
        )
    return found


def of_problem(problem, *, fixed_images=(), held=(), loss="trivial"):
    """A FactorGraph with the keys of ``model/problem_keys.py``; ``held``: camera parameters."""
    found = bundle.FactorGraph()
    for key, pose in zip(problem.image_ids.tolist(), problem.cam_from_world, strict=True):
        found.add_variable(("image", key), pose, "se3", fixed=key in fixed_images)
    names = camera_models()
    for k, key in enumerate(problem.camera_ids.tolist()):
        size = len(names[problem.camera_models[k]])
        found.add_variable(("camera", key), problem.camera_params[k, :size], fixed=held)
    for key, point in zip(problem.point_ids.tolist(), problem.points, strict=True):
        found.add_variable(("point", key), point)
    for image, point, xy in zip(
        problem.observation_image, problem.observation_point, problem.observation_xy, strict=True
    ):
        camera = problem.image_camera[image]
        found.add_factor(
            bundle.ReprojectionFactor(
                ("image", int(problem.image_ids[image])),
                ("camera", int(problem.camera_ids[camera])),
                ("point", int(problem.point_ids[point])),
                xy,
                problem.camera_models[camera],
                loss=loss,
            )
        )
    return found
