"""The tether: ANCF cable elements, their energy-momentum step, statics, twist, payout."""
