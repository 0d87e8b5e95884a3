"""Operator interface: table of commands, link to the nodes, command line and web page."""
