"""Proof of the recommendation: real renders kept as data, and how often the advice drawn from them holds.

`python -m tests.recommend.study` renders the data, `python -m tests.recommend` scores the rules on them.
"""
