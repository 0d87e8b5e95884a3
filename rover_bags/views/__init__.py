"""Present results as text, JSON, plots, animations and HTML pages.

``summary`` makes the terminal text and the JSON, ``sections`` the tables shared by text and page,
``plots``, ``run_plots`` and ``coverage_plot`` the plots, ``animation`` and ``spatial_scene`` the
animations. ``report_page`` assembles the page from ``markup`` and ``page``.
"""
