"""Actions: typed goals that become commands of the contract."""
