"""The `mother_rover` command: nodes, demonstration, verification, studies, bags, hardware tests.

`subcommands` lists every subcommand with the module that implements it; `command_line` parses and
dispatches. A module is imported only when its subcommand is used.
"""
