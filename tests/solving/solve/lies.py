"""Wrong Jacobians of the reprojection residual, as people write them."""

import numpy as np


def scaled(part, column, factor):
    """One column times a factor."""

    def lie(parts):
        block = getattr(parts, part).copy()
        block[..., column] *= factor
        return parts._replace(**{part: block})

    return lie


def swapped(part, first, second):
    """Two columns in each other's place."""

    def lie(parts):
        block = getattr(parts, part).copy()
        block[..., [first, second]] = block[..., [second, first]]
        return parts._replace(**{part: block})

    return lie


def mixed(part, matrix):
    """The block times a matrix, as when the derivative is taken in the wrong frame."""

    def lie(parts):
        return parts._replace(**{part: getattr(parts, part) @ matrix})

    return lie


def rows(part, factors):
    """Rows times factors: the derivatives of x and y."""

    def lie(parts):
        return parts._replace(**{part: getattr(parts, part) * np.reshape(factors, (2, 1))})

    return lie


DEGREES = np.pi / 180
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
ROTATION, TRANSLATION, FOCAL, K1 = slice(0, 3), slice(3, 6), 0, 3

# name -> changes to scenes.make_problem, camera parameters to refine
SCENES = {
    "arc": ({"seed": 0}, [0, 3]),
    "shared camera": ({"seed": 7, "shared": True}, [0, 3]),
    "short tracks": ({"seed": 8, "model": "RADIAL", "track": 3, "num_images": 6}, [0, 3, 4]),
    "noisy": ({"seed": 9, "noise": 5.0}, [0, 3]),
    "bad start": ({"seed": 2, "perturbation": 5e-2}, [0, 3]),
}

# name -> lie, for SIMPLE_RADIAL and RADIAL: f cx cy k1 ...
LIES = {
    "sign of k1": scaled("d_params", K1, -1),
    "factor 2 on k1": scaled("d_params", K1, 2),
    "factor 1/2 on k1": scaled("d_params", K1, 0.5),
    "k1 forgotten": scaled("d_params", K1, 1e-3),
    "sign of the focal length": scaled("d_params", FOCAL, -1),
    "factor 2 on the focal length": scaled("d_params", FOCAL, 2),
    "factor 1/2 on the focal length": scaled("d_params", FOCAL, 0.5),
    "focal length and k1 swapped": swapped("d_params", FOCAL, K1),
    "sign of the rotation": scaled("d_pose", ROTATION, -1),
    "sign of rotation y": scaled("d_pose", 1, -1),
    "sign of rotation z": scaled("d_pose", 2, -1),
    "factor 2 on the rotation": scaled("d_pose", ROTATION, 2),
    "factor 1/2 on the rotation": scaled("d_pose", ROTATION, 0.5),
    "degrees for radians": scaled("d_pose", ROTATION, DEGREES),
    "radians for degrees": scaled("d_pose", ROTATION, 1 / DEGREES),
    "rotation x and y swapped": swapped("d_pose", 0, 1),
    "rotation and translation swapped": mixed("d_pose", np.roll(np.eye(6), 3, axis=0)),
    "translation x and y swapped": swapped("d_pose", 3, 4),
    "sign of translation z": scaled("d_pose", 5, -1),
    "factor 2 on translation z": scaled("d_pose", 5, 2),
    "translation z forgotten": scaled("d_pose", 5, 1e-3),
    "sign of point z": scaled("d_point", 2, -1),
    "factor 2 on points": scaled("d_point", slice(None), 2),
    "factor 1/2 on points": scaled("d_point", slice(None), 0.5),
    "points in the wrong frame": mixed("d_point", TURN),
    "points' y row off by a factor of 1.5": rows("d_point", [1, 1.5]),
    "sign of the y row of poses": rows("d_pose", [1, -1]),
}

# Lies that leave a signature in the iterations of every solve.
CAUGHT = [
    "sign of k1",
    "sign of the focal length",
    "factor 2 on the focal length",
    "sign of the rotation",
    "sign of rotation y",
    "factor 2 on the rotation",
    "radians for degrees",
    "rotation and translation swapped",
    "translation x and y swapped",
    "sign of translation z",
    "sign of point z",
    "factor 2 on points",
    "points in the wrong frame",
    "sign of the y row of poses",
]
# Lies that leave one in some: the solve ends before there is enough to see, or curvature blurs it.
UNCERTAIN = [
    "factor 2 on k1",
    "sign of rotation z",
    "factor 1/2 on k1",
    "factor 1/2 on the focal length",
    "factor 1/2 on the rotation",
    "rotation x and y swapped",
    "factor 2 on translation z",
    "factor 1/2 on points",
    "points' y row off by a factor of 1.5",
]
# Lies that make a solve look badly scaled, which honest ones may be as well: for the spot check.
UNSEEN = [
    "k1 forgotten",
    "focal length and k1 swapped",
    "degrees for radians",
    "translation z forgotten",
]
