"""What people and machines are shown: text, JSON, plots, animations and pages.

``summary`` is the terminal's text and the JSON, ``sections`` the tables that text and page share;
``plots``, ``run_plots`` and ``coverage_plot`` draw, ``animation`` and ``spatial_scene`` move,
``report_page`` puts a page together from ``markup`` and ``page``.
"""
