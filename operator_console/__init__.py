"""What operators see and do: the table of their commands, the way there and back, command line."""
