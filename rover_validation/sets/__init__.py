"""Folders of measured sets, summarised for the document of the validation."""
