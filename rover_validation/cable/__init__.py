"""The tether's laws against the measured motion of cables that are held and moved at both ends."""
