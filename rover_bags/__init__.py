"""Bags: recorded, rescued, read and reported.

``record`` is the recorder node (the only module here that needs rclpy); ``store`` writes the
files, ``scan`` walks them record by record whatever their state, ``recover`` makes a clean bag of
a broken one, ``read`` turns a bag into typed series by the contract's table, ``metrics`` finds
jumps and figures in those, and ``report``, ``plots`` and ``animation`` show them.
"""
