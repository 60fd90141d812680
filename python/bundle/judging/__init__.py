"""Judgement of models: held-out errors, validation of candidates, comparison with a reference."""
