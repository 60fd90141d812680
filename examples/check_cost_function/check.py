"""Check the cost functions of costs.cpp: a correct one, and one with a sign error."""

import costs

import bundle

BLOCKS = [[800.0, -0.1], [0.4, -0.3, 2.0]]
NAMES = [("camera", ["f", "k"]), ("point", ["point x", "point y", "point z"])]

# A unit test needs this line only.
assert bundle.check_gradients(costs.radial(160.0, -120.0), BLOCKS, names=NAMES)

report = bundle.check_gradients(costs.radial_with_sign_error(160.0, -120.0), BLOCKS, names=NAMES)
print(report)
assert report.kinds == {"sign"}
