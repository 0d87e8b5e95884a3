"""The contract of the suite: topics, types, quality of service, frames, units, limits.

``table`` lists every topic and service; ``samples`` are the typed contents of messages;
``layouts`` are the bytes of each message type; ``cdr`` converts between samples and these bytes and
refuses what the table forbids; ``parameters`` are typed values with units and ranges. Only ``qos``
needs rclpy, and ``message_types`` the message packages.
"""
