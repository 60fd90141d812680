"""Few rows in which every pair of values of two factors occurs."""

import itertools
import random


def covering(factors, allowed, *, seed, candidates=12):
    """Rows of {factor: value} such that every pair that some allowed row has is in one of them.

    Greedy: each row starts from a pair that is still missing, is filled up at random, and the best
    of some such rows is taken. `allowed` says whether a whole row makes sense.
    """
    draw = random.Random(seed)
    names = list(factors)
    missing = {
        ((a, x), (b, y))
        for a, b in itertools.combinations(names, 2)
        for x in factors[a]
        for y in factors[b]
    }
    rows, failures = [], 0
    while missing and failures < 20:
        first = draw.sample(sorted(missing, key=repr), 1)[0]
        tried = []
        for _ in range(candidates):
            row = {name: draw.choice(values) for name, values in factors.items()} | dict(first)
            if allowed(row):
                tried.append((len(missing & pairs(row)), repr(row), row))
        if not tried:  # perhaps no allowed row has this pair
            failures += 1
            continue
        best = max(tried)[2]
        failures = 0
        missing -= pairs(best)
        rows.append(best)
    return rows


def pairs(row):
    return set(itertools.combinations(row.items(), 2))
