"""Build of the documentation as a site: `make docs`, or rosdoc2. The source is the tree itself."""

import re
import shlex
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

project = "mother_rover"
author = "mother_rover maintainers"
project_copyright = author
release = version = re.search(  # type: ignore[union-attr]
    r"<version>(.+?)</version>", (ROOT / "package.xml").read_text(encoding="utf-8")
)[1]

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinxcontrib.mermaid",
    "sphinx_copybutton",
    "sphinx-mathjax-offline",
]
root_doc = "docs/index"
include_patterns = ["README.md", "CONTRIBUTING.md", "CHANGELOG.rst", "docs/**"]
exclude_patterns = ["docs/**/*.py", "docs/**/*.yaml"]

myst_enable_extensions = ["dollarmath", "amsmath", "html_image"]
myst_heading_anchors = 4
myst_fence_as_directive = ["mermaid"]

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings give shapes and units
napoleon_google_docstring = True
napoleon_numpy_docstring = False

# Drawn here, so that the site needs no network; on white, for the dark theme too.
mermaid_output_format = "svg"
mermaid_cmd = shlex.quote(str(Path(sys.executable).with_name("mermaidx")))
mermaid_params = ["--background", "white"]

html_theme = "furo"
html_static_path = html_css_files = ["site.css"]
html_title = f"mother_rover {release}"
html_copy_source = False
html_show_copyright = False
