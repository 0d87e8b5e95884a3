"""The driving rover: odometry, planning, following, watch and its node."""
