"""The source paper's study of the tethered jump."""
