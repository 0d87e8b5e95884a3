"""What lies on disk: bags written, walked record by record whatever their state, vouched for.

``store`` writes bags and ``spool`` hands it what the recorder hears; ``scan`` walks the files of
any bag (``mcap_scan``, ``sqlite_scan``), ``folder`` tells which they are. Bytes, not numbers.
"""
