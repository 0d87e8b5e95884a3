"""Compute activities, metrics and audits from a bag's time series.

``signals`` resamples the sensors that distinguish activities, ``timeline`` finds the activities,
``activities``, ``jumps`` and ``wall_coverage`` compute their metrics, ``audits`` checks the energy
and momentum balances, and ``metrics`` collects the results.
"""
