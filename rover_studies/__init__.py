"""Studies: many simulated runs of one plan, and what they show together.

`sweep` runs grids and Monte Carlo plans over any parameters of any scenario; `whole_study` is the
source paper's own study of the tethered jump, built on it.
"""
