"""File formats: write bags, and scan intact or damaged bags record by record.

``store`` writes bags and ``write_queue`` decouples it from the recorder. ``scan`` reads all files
of a bag (``mcap_scan``, ``sqlite_scan``), which ``folder`` finds. Messages stay serialised here.
"""
