"""Record, recover, read, report and re-simulate bags, and identify parameters from them.

``recording`` has the recorder, the only part that needs rclpy. ``files`` writes, scans and recovers
bag files; ``reading`` turns a bag into time series typed by the contract. On these stand
``analysis`` (activities, metrics and audits), ``resimulation``, ``identification`` and ``views``
(text, plots, pages and tables).
"""
