"""Record, recover, read, report and re-simulate bags, and identify parameters from them.

One module per command: ``record`` (the recorder node, the only one that needs rclpy), ``recover``,
``report``, ``compare``, ``resim`` and ``identify``. ``read`` turns a bag into time series typed by
the contract; ``bag_analysis`` reads, measures and draws a bag of any length.

Subpackages: ``files`` (file formats), ``analysis`` (metrics and audits), ``views`` (text, plots and
pages) and ``identification`` (parameter estimation).
"""
