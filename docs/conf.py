"""How Sphinx builds the site from the Markdown in this folder: `make docs`, which treats warnings as errors.

No page asks the network for anything: fonts are the system's, scripts and styles lie beside the pages.
"""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent / "scripts"), str(HERE.parent / "src")]

from mimesh import __version__  # noqa: E402

project = "mimesh"
author = "The mimesh authors"
project_copyright = "The mimesh authors. Apache-2.0"
release = version = __version__

# No sphinx.ext.mathjax: it would fetch its script, so equations are written as text.
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "inserts", "signatures"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "results"]

myst_enable_extensions = ["attrs_block", "attrs_inline", "deflist"]
myst_heading_anchors = 4
# Pages may leave out a level of headings.
suppress_warnings = ["myst.header"]

# They would make one dash of the two of an option.
smartquotes = False
default_role = "code"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 90

html_theme = "furo"
html_title = "mimesh"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_last_updated_fmt = None
html_theme_options = {"top_of_page_buttons": []}
pygments_style = "friendly"
pygments_dark_style = "github-dark"
