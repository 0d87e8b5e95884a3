"""Estimate parameters of the machine from recorded runs, by least squares on the plant.

``parameters`` lists the parameters. ``runs`` turns bags into experiments, which ``workers``
simulates. ``noise`` whitens the residuals, ``fit`` minimises them, and ``profile`` bounds poorly
known parameters. ``dry_run`` holds the manoeuvres that excite every parameter, and simulates them.
"""
