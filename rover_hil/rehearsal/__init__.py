"""Rehearsals: a written procedure is run against a machine, and leaves a record."""
