"""The contract of the suite: topics, types, quality of service, frames, units, limits.

``table`` lists every topic and service; ``samples`` are the typed contents of messages;
``codecs`` convert between samples and messages and refuse what the table forbids;
``parameters`` are typed values with units and ranges; ``node`` is the base class of
every node. Only ``node``, ``publisher``, ``ros_parameters`` and ``qos`` need rclpy.
"""
