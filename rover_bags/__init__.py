"""Bags: recorded, rescued, read, reported, simulated again, and what they tell of the machine.

Each executable has its module here: ``record`` (the recorder node, the only one that needs
rclpy), ``recover``, ``report``, ``resim`` and ``identify``. ``read`` turns a bag into typed tracks
by the contract's table, ``survey`` reads, measures and draws one of any length, ``compare`` sets
several side by side.

Below them: ``files`` (what lies on disk), ``findings`` (what it tells), ``views`` (what is
shown) and ``identification`` (of what machine it can be).
"""
