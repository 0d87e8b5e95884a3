"""The contract of the suite: topics, types, quality of service, frames, units, limits.

``table`` lists every topic and service; ``samples`` are what messages say;
``codecs`` turn one into the other and refuse what the table forbids;
``parameters`` are typed values with units and ranges; ``node`` is the shell of
every node (which, with ``publisher``, ``ros_parameters`` and ``qos``, needs rclpy).
"""
