"""Bags as time series, typed by the contract."""
