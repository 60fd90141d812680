"""Every camera model as a formula of its own, for any kind of number.

The formulas are written on functions that a backend provides: ``NUMPY`` computes with arrays of
floats or complex numbers (for complex-step derivatives, hence no function that is not analytic),
``MPMATH`` with single numbers of any precision. They say what a model means and are written for
reading: they cancel near the axis and divide by zero on it.
"""

from types import SimpleNamespace

import mpmath
import numpy as np

_PINHOLE = (800.0, 790.0, 400.0, 300.0)
PARAMS = {
    "SIMPLE_PINHOLE": [800.0, 400.0, 300.0],
    "PINHOLE": [800.0, 790.0, 400.0, 300.0],
    "SIMPLE_RADIAL": [800.0, 400.0, 300.0, -0.03],
    "RADIAL": [800.0, 400.0, 300.0, -0.05, 0.01],
    "OPENCV": [800.0, 790.0, 400.0, 300.0, -0.05, 0.01, 0.001, -0.002],
    "OPENCV_FISHEYE": [800.0, 790.0, 400.0, 300.0, -0.03, 0.01, -0.004, 0.001],
    "FULL_OPENCV": [*_PINHOLE, -0.05, 0.01, 0.001, -0.002, 0.005, 0.02, -0.01, 0.003],
    "FOV": [800.0, 790.0, 400.0, 300.0, 0.9],
    "SIMPLE_RADIAL_FISHEYE": [800.0, 400.0, 300.0, -0.03],
    "RADIAL_FISHEYE": [800.0, 400.0, 300.0, -0.03, 0.01],
    "THIN_PRISM_FISHEYE": [*_PINHOLE, -0.03, 0.01, 0.001, -0.002, -0.004, 0.001, 0.002, -0.001],
    "RAD_TAN_THIN_PRISM_FISHEYE": [
        *_PINHOLE,
        -0.03,
        0.01,
        -0.004,
        0.001,
        0.002,
        -0.0005,
        0.001,
        -0.002,
        0.002,
        -0.001,
        0.001,
        0.0005,
    ],
    "SIMPLE_DIVISION": [800.0, 400.0, 300.0, -0.08],
    "DIVISION": [800.0, 790.0, 400.0, 300.0, -0.08],
    "SIMPLE_FISHEYE": [800.0, 400.0, 300.0],
    "FISHEYE": [800.0, 790.0, 400.0, 300.0],
    "EUCM": [800.0, 790.0, 400.0, 300.0, 0.6, 1.1],
    "EQUIRECTANGULAR": [2000.0, 1000.0],
}


def _numpy_atan2(y, x):
    """atan2 for complex arguments with tiny imaginary parts."""
    y, x = np.asarray(y), np.asarray(x)
    if not (np.iscomplexobj(y) or np.iscomplexobj(x)):
        return np.arctan2(y, x)
    slope = (x.real * y.imag - y.real * x.imag) / (x.real**2 + y.real**2)
    return np.arctan2(y.real, x.real) + 1j * slope


NUMPY = SimpleNamespace(
    pi=np.pi,
    sqrt=np.sqrt,
    atan=np.arctan,
    atan2=_numpy_atan2,
    tan=np.tan,
    choose=lambda condition, yes, no: np.where(condition, yes(), no()),
    less=lambda a, b: np.real(a) < b,
)
MPMATH = SimpleNamespace(
    pi=+mpmath.pi,
    sqrt=mpmath.sqrt,
    atan=mpmath.atan,
    atan2=mpmath.atan2,
    tan=mpmath.tan,
    choose=lambda condition, yes, no: yes() if condition else no(),
    less=lambda a, b: a < b,
)


def project(model, p, x, y, z, m=NUMPY):
    """Pixels (x, y) of the point (x, y, z) of the camera frame, by the functions of ``m``."""
    if model in _WHOLE:
        return _WHOLE[model](p, x, y, z, m)
    num_focal = 1 if model.startswith("SIMPLE") or model in ("RADIAL", "RADIAL_FISHEYE") else 2
    if "FISHEYE" in model:
        r = m.sqrt(x * x + y * y)
        angle = m.atan2(r, z)
        u, v = angle / r * x, angle / r * y
    else:
        u, v = x / z, y / z
    u, v = _DISTORTIONS[model](p[num_focal + 2 :], u, v, m)
    return p[0] * u + p[num_focal], p[num_focal - 1] * v + p[num_focal + 1]


def _radial(k, u, v, _):
    s = u * u + v * v
    d = 1 + sum(coefficient * s ** (j + 1) for j, coefficient in enumerate(k))
    return d * u, d * v


def _tangential(p1, p2, u, v):
    s = u * u + v * v
    return 2 * p1 * u * v + p2 * (s + 2 * u * u), 2 * p2 * u * v + p1 * (s + 2 * v * v)


def _full_opencv(k, u, v, _):
    k1, k2, p1, p2, k3, k4, k5, k6 = k
    s = u * u + v * v
    d = (1 + k1 * s + k2 * s**2 + k3 * s**3) / (1 + k4 * s + k5 * s**2 + k6 * s**3)
    du, dv = _tangential(p1, p2, u, v)
    return d * u + du, d * v + dv


def _opencv(k, u, v, m):
    k1, k2, p1, p2 = k
    return _full_opencv((k1, k2, p1, p2, 0, 0, 0, 0), u, v, m)


def _fov(k, u, v, m):
    """COLMAP's, with its two series."""
    (omega,) = k
    s, omega2, t = u * u + v * v, omega * omega, m.tan(omega / 2)
    factor = m.choose(
        m.less(omega2, 1e-4),
        lambda: 1 + omega2 * s / 3 - omega2 / 12,
        lambda: m.choose(
            m.less(s, 1e-4),
            lambda: -2 * t * (4 * s * t * t - 3) / (3 * omega),
            lambda: m.atan(2 * m.sqrt(s) * t) / (m.sqrt(s) * omega),
        ),
    )
    return factor * u, factor * v


def _thin_prism(k, u, v, m):
    k1, k2, p1, p2, k3, k4, sx, sy = k
    s = u * u + v * v
    (ru, rv), (tu, tv) = _radial((k1, k2, k3, k4), u, v, m), _tangential(p1, p2, u, v)
    return ru + tu + sx * s, rv + tv + sy * s


def _rad_tan_thin_prism(k, u, v, m):
    a, b = _radial(k[:6], u, v, m)
    p0, p1, s0, s1, s2, s3 = k[6:]
    q = a * a + b * b
    ta, tb = _tangential(p1, p0, a, b)
    return a + ta + s0 * q + s1 * q * q, b + tb + s2 * q + s3 * q * q


_DISTORTIONS = {
    "FULL_OPENCV": _full_opencv,
    "OPENCV": _opencv,
    "FOV": _fov,
    "THIN_PRISM_FISHEYE": _thin_prism,
    "RAD_TAN_THIN_PRISM_FISHEYE": _rad_tan_thin_prism,
    **dict.fromkeys(["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_FISHEYE", "FISHEYE"], _radial),
    **dict.fromkeys(["SIMPLE_RADIAL", "RADIAL"], _radial),
    **dict.fromkeys(["SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE"], _radial),
}


def _division(p, x, y, z, m):
    k = p[-1]
    scale = 2 / (z + m.sqrt(z * z - 4 * k * (x * x + y * y)))
    return p[0] * scale * x + p[-3], p[-4] * scale * y + p[-2]


def _eucm(p, x, y, z, m):
    fx, fy, cx, cy, alpha, beta = p
    depth = alpha * m.sqrt(beta * (x * x + y * y) + z * z) + (1 - alpha) * z
    return fx * x / depth + cx, fy * y / depth + cy


def _equirectangular(p, x, y, z, m):
    width, height = p
    azimuth, elevation = m.atan2(x, z), m.atan2(-y, m.sqrt(x * x + z * z))
    return (azimuth / (2 * m.pi) + 0.5) * width, (0.5 - elevation / m.pi) * height


_WHOLE = {
    "SIMPLE_DIVISION": _division,
    "DIVISION": _division,
    "EUCM": _eucm,
    "EQUIRECTANGULAR": _equirectangular,
}
