"""The link between contract and drives: CANopen, a bridge to the contract, and emulated devices."""
