"""The bridge between the contract and the devices on the link."""
