"""The ground: terrain and boulders, and the contact of tether, bodies and wheels with it."""
