"""What a bag tells: from its tracks to activities, figures and audits. Numbers, not pictures.

``signals`` are the tracks by which activities are told apart, ``timeline`` those activities,
``activities``, ``jumps`` and ``wall_coverage`` their figures, ``audits`` whether energy and
momentum add up, ``metrics`` all of it together.
"""
