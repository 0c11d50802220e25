"""Sphinx's settings for the documentation. `make docs` builds it into build/docs."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent / "_ext"))

import blocks

project = "blocks"
copyright = "the blocks authors"
version = release = blocks.__version__

extensions = ["myst_nb", "reference"]
myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "fieldlist"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # notebooks hold their outputs; `make test-long` runs them
nb_render_markdown_format = "myst"
exclude_patterns = ["_build"]
smartquotes = False

html_theme = "furo"
html_title = f"blocks {version}"
html_static_path = ["_static"]
html_css_files = ["blocks.css"]
html_copy_source = False
html_show_sourcelink = False
html_show_search_summary = False  # a page opened from a file may not read others: each summary would be an error
html_use_index = False
html_domain_indices = False
python_maximum_signature_line_length = 90
