"""Long seeded searches for crashes and silent nonsense; the tests run a few dozen rounds of each.

python -m tests.campaigns.mutants 10000
python -m tests.campaigns.degenerate 4000
"""
