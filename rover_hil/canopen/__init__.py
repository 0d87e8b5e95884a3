"""CANopen on the link: devices, object dictionaries, transports, impairments."""
