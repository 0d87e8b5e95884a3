"""Parameter studies: many simulations of one plan, and their evaluation.

`sweep` runs grids and Monte Carlo plans over the parameters of scenarios; `whole_study` uses it to
reproduce the source paper's study of the tethered jump.
"""
