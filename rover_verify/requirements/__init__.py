"""Requirements, their matrix, and its page."""
