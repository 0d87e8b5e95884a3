"""What a machine was like, found in recorded runs by least squares on the plant.

``parameters`` says what may be sought and ``runs`` turns bags into experiments that can be
simulated again, by ``workers``; ``noise`` makes their errors white and ``fit`` minimises them.
``rehearsal`` holds the manoeuvres that show every parameter, and simulates them.
"""
