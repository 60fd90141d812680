"""Long seeded searches for crashes and silent nonsense; the tests run a few dozen rounds of each.

python -m tests.campaigns.mutants 10000
python -m tests.campaigns.degenerate 4000
python -m tests.campaigns.foreign_mutants 2000
python -m tests.campaigns.kapture_readers KAPTURE/bin
"""
